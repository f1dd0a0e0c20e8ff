// An array whose memory is not set to zero: the user writes every element before reading it.
#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <new>

#ifdef __linux__
#include <sys/mman.h>
#endif

namespace torchjoint {

constexpr size_t kHugePage = size_t{2} << 20;

// Asks for huge pages if the memory is large. Random access to many small pages is slow, and so is the first access to
// each page. The memory must not be written yet; it may begin and end anywhere.
inline void use_huge_pages([[maybe_unused]] void* data, [[maybe_unused]] size_t bytes) {
#ifdef __linux__
  const auto begin = reinterpret_cast<uintptr_t>(data), first = (begin + kHugePage - 1) / kHugePage * kHugePage;
  const uintptr_t last = (begin + bytes) / kHugePage * kHugePage;
  if (last > first) madvise(reinterpret_cast<void*>(first), last - first, MADV_HUGEPAGE);
#endif
}

template <typename T>
class Array {
 public:
  explicit Array(size_t length) : size_(length), data_(allocate(length * sizeof(T))) {}

  T& operator[](size_t i) { return data_.get()[i]; }
  const T& operator[](size_t i) const { return data_.get()[i]; }
  T* data() { return data_.get(); }
  const T* data() const { return data_.get(); }
  size_t size() const { return size_; }

 private:
  static_assert(std::is_trivially_copyable_v<T> && std::is_trivially_destructible_v<T>);

  static size_t alignment(size_t bytes) { return bytes >= 2 * kHugePage ? kHugePage : 64; }

  struct Free {
    size_t bytes;
    void operator()(T* data) const { ::operator delete(data, std::align_val_t{alignment(bytes)}); }
  };

  static std::unique_ptr<T, Free> allocate(size_t bytes) {
    void* data = ::operator new(bytes, std::align_val_t{alignment(bytes)});
    if (bytes >= 2 * kHugePage) use_huge_pages(data, bytes);
    return {static_cast<T*>(data), Free{bytes}};
  }

  size_t size_;
  std::unique_ptr<T, Free> data_;
};

}  // namespace torchjoint
