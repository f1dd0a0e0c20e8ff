// Traverses two lists that are sorted by their keys.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <span>

namespace torchjoint {

// A list is searched instead of traversed if it is this many times longer than the other list.
constexpr size_t kMuchLonger = 8;

// The first item from `place` on that has at least this key.
template <typename Place>
Place first_from(Place place, Place end, int64_t key, bool is_searched) {
  if (is_searched) return std::lower_bound(place, end, key, [](const auto& a, int64_t k) { return a.key < k; });
  while (place != end && place->key < key) ++place;
  return place;
}

// Calls `function(a, b)` for each key that occurs in two lists with ascending keys.
template <typename Item, typename Function>
void for_each_common(std::span<const Item> one, std::span<const Item> other, const Function& function) {
  const bool search_one = one.size() / kMuchLonger > other.size(),
             search_other = other.size() / kMuchLonger > one.size();
  auto a = one.begin(), b = other.begin();
  while (a != one.end() && b != other.end()) {
    if (a->key == b->key) {
      function(*a++, *b++);
    } else if (a->key < b->key) {
      a = first_from(a, one.end(), b->key, search_one);
    } else {
      b = first_from(b, other.end(), a->key, search_other);
    }
  }
}

}  // namespace torchjoint
