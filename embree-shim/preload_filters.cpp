// Wrapped filter functions. Embree passes a filter nothing that would lead to the wrapped one, so each function of the program
// gets a wrapper of its own out of a fixed number; programs have few.
#include "preload_filters.hpp"

#include <atomic>
#include <array>
#include <utility>

#include "asking_filters.hpp"
#include "preload_thread.hpp"

namespace preload {
namespace {

constexpr std::size_t most_filters = 128;

std::atomic<RTCFilterFunctionN> filters[most_filters];

template <std::size_t number>
void wrapper(const RTCFilterFunctionNArguments* arguments) {
  const RTCFilterFunctionN filter = filters[number].load(std::memory_order_relaxed);
  Thread* thread = this_thread();
  Frame* frame = thread == nullptr ? nullptr : thread->frame;
  if (frame == nullptr || frame->capture == nullptr) return filter(arguments);
  const std::uint64_t lost = shim::asking::watch(*frame, *frame->capture, *arguments, filter);
  if (lost == 0) return;
  if (ExchangeHeader* header = exchange()) add(header->lost_rejects, lost);
}

template <std::size_t... numbers>
constexpr std::array<RTCFilterFunctionN, most_filters> make_wrappers(std::index_sequence<numbers...>) {
  return {&wrapper<numbers>...};
}

constexpr auto wrappers = make_wrappers(std::make_index_sequence<most_filters>());

}  // namespace

RTCFilterFunctionN wrapped(RTCFilterFunctionN filter) noexcept {
  if (filter == nullptr || exchange() == nullptr || !real().is_known()) return filter;
  for (std::size_t number = 0; number < most_filters; number++) {
    if (wrappers[number] == filter) return filter;
    RTCFilterFunctionN there = filters[number].load(std::memory_order_acquire);
    if (there == nullptr && filters[number].compare_exchange_strong(there, filter)) there = filter;
    if (there == filter) return wrappers[number];
  }
  fail("the program has more than 128 filter functions");
  return filter;
}

}  // namespace preload

void rtcSetGeometryIntersectFilterFunction(RTCGeometry geometry, RTCFilterFunctionN filter) {
  preload::real().rtcSetGeometryIntersectFilterFunction(geometry, preload::wrapped(filter));
}

void rtcSetGeometryOccludedFilterFunction(RTCGeometry geometry, RTCFilterFunctionN filter) {
  preload::real().rtcSetGeometryOccludedFilterFunction(geometry, preload::wrapped(filter));
}
