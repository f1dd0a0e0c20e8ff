// The floor under a graph segmentation with edges given: an argsort of their weights, and nothing else. A bare radix
// sort of float32 keys with their positions, least significant digit first, three passes of 11 bits, in memory that the
// caller has ready.
#include <bit>
#include <cstdint>
#include <utility>

namespace {
constexpr int kBits = 11, kPasses = 3;
constexpr uint32_t kDigits = 1u << kBits;

struct Keyed {
  uint32_t key, position;
};

uint32_t digit(uint32_t key, int pass) { return (key >> (pass * kBits)) & (kDigits - 1); }
}  // namespace

// `first` and `second` have room for `count` pairs each; the order ends up in the positions of `second`.
extern "C" void radix_argsort(const float* weight, int64_t count, Keyed* first, Keyed* second) {
  static thread_local uint32_t starts[kPasses][kDigits];
  for (auto& pass : starts) {
    for (auto& start : pass) start = 0;
  }
  for (int64_t i = 0; i < count; ++i) {
    const uint32_t bits = std::bit_cast<uint32_t>(weight[i]);
    const uint32_t key = (bits & 0x80000000u) ? ~bits : bits | 0x80000000u;
    first[i] = {key, static_cast<uint32_t>(i)};
    for (int pass = 0; pass < kPasses; ++pass) ++starts[pass][digit(key, pass)];
  }
  for (int pass = 0; pass < kPasses; ++pass) {
    uint32_t start = 0;
    for (uint32_t& entry : starts[pass]) start += std::exchange(entry, start);
    for (int64_t i = 0; i < count; ++i) second[starts[pass][digit(first[i].key, pass)]++] = first[i];
    std::swap(first, second);
  }
}
