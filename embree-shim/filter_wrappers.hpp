// Wrapped filter functions. Embree passes a filter nothing that would lead to the wrapped one, so each function of the program
// gets a wrapper of its own out of a fixed number; programs have few.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <utility>

namespace shim {

// `watch` has the program's filter decide, and sees what it does.
template <typename Arguments, void (*watch)(const Arguments&, void (*)(const Arguments*))>
class FilterWrappers {
 public:
  using Filter = void (*)(const Arguments*);

  static constexpr std::size_t most = 128;

  // A function that does what `filter` does while it is watched, and the same for one that is wrapped already; null when the
  // program has more functions than there are wrappers.
  static Filter wrapped(Filter filter) noexcept {
    for (std::size_t number = 0; number < most; number++) {
      if (wrappers()[number] == filter) return filter;
      Filter there = filters_[number].load(std::memory_order_acquire);
      if (there == nullptr && filters_[number].compare_exchange_strong(there, filter)) there = filter;
      if (there == filter) return wrappers()[number];
    }
    return nullptr;
  }

  // What a wrapper wraps; null for what is none.
  static Filter unwrapped(Filter filter) noexcept {
    for (std::size_t number = 0; number < most; number++) {
      if (wrappers()[number] == filter) return filters_[number].load(std::memory_order_acquire);
    }
    return nullptr;
  }

 private:
  template <std::size_t number>
  static void wrapper(const Arguments* arguments) {
    watch(*arguments, filters_[number].load(std::memory_order_relaxed));
  }

  template <std::size_t... numbers>
  static constexpr std::array<Filter, most> make(std::index_sequence<numbers...>) {
    return {&wrapper<numbers>...};
  }

  static const std::array<Filter, most>& wrappers() noexcept {
    static constexpr std::array<Filter, most> all = make(std::make_index_sequence<most>());
    return all;
  }

  static inline std::atomic<Filter> filters_[most];
};

}  // namespace shim
