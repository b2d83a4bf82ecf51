// Wrapped filter functions. Embree passes a filter nothing that would lead to the wrapped one, so each function of the program
// gets a wrapper of its own out of a fixed number; programs have few.
#include "preload_filters.hpp"

#include <atomic>
#include <array>
#include <utility>

#include "preload_thread.hpp"

namespace preload {
namespace {

constexpr std::size_t most_filters = 128;

std::atomic<RTCFilterFunctionN> filters[most_filters];

// Whether the ray in lane `lane` of a filter's packet is the one in lane `asked` of the call.
bool is_same_ray(const Frame& frame, const RTCFilterFunctionNArguments& arguments, unsigned lane, unsigned asked) noexcept {
  // Origin and direction.
  for (const unsigned field : {0u, 1u, 2u, 4u, 5u, 6u}) {
    const auto* seen = reinterpret_cast<const float*>(arguments.ray) + field * arguments.N + lane;
    if (std::memcmp(seen, frame.at(frame.rays, asked, field), sizeof(float)) != 0) return false;
  }
  return true;
}

// Which of the rays that were asked lane `lane` of a filter's packet is; `lanes` when that is not known. Embree cuts packets
// and streams as it likes where it has no kernel of their width; then the ray itself tells, unless an instance has turned it.
std::uint32_t asked_lane(const Frame& frame, const RTCFilterFunctionNArguments& arguments, unsigned lane) noexcept {
  if (frame.lanes == 1) return 0;
  constexpr unsigned widest_packet = 16;
  if (arguments.N == frame.lanes && frame.lanes <= widest_packet) return lane;
  for (std::uint32_t asked = 0; asked < frame.lanes; asked++) {
    if (is_same_ray(frame, arguments, lane, asked)) return asked;
  }
  return frame.lanes;
}

// The candidate in lane `lane` of a filter's packet. Embree has put its distance into the ray's
// tfar.
Hit candidate(const RTCFilterFunctionNArguments& arguments, unsigned lane) noexcept {
  // The hit stands apart, and Field counts it as if it followed the ray.
  constexpr unsigned ray_fields = 12;
  return hit_of([&](unsigned field) {
    const bool of_ray = field < ray_fields;
    const void* from = of_ray ? static_cast<const void*>(arguments.ray) : arguments.hit;
    return static_cast<const float*>(from) + (of_ray ? field : field - ray_fields) * arguments.N + lane;
  });
}

void note_reject(Frame& frame, std::uint32_t asked, const Hit& hit) noexcept {
  Thread& thread = *frame.thread;
  // What another filter, which was asked before, has made of it.
  if (thread.changed_count > frame.first_changed) {
    const Changed& last = thread.changed[thread.changed_count - 1];
    if (last.lane == asked && is_same(last.after, hit)) {
      thread.changed_count--;
      return note_reject(frame, asked, last.before);
    }
  }
  const std::uint32_t triangle =
      frame.capture->triangle(hit.instance, hit.geometry, hit.primitive, hit.u, hit.v).triangle;
  // What is not a triangle is not replayed.
  if (triangle == shim::no_triangle) return;
  if (asked == frame.lanes || thread.rejected_count == Thread::most_rejected) {
    if (ExchangeHeader* header = exchange()) add(header->lost_rejects, std::uint64_t{1});
    return;
  }
  // With spatial splits a candidate may come again.
  for (std::uint32_t before = frame.first_rejected; before < thread.rejected_count; before++) {
    if (thread.rejected[before].lane == asked && thread.rejected[before].triangle == triangle) return;
  }
  thread.rejected[thread.rejected_count++] = {asked, triangle};
}

void note_change(Frame& frame, std::uint32_t asked, const Hit& before, const Hit& after) noexcept {
  Thread& thread = *frame.thread;
  // A filter of the geometry, and one of the call, may both change a candidate.
  for (std::uint32_t number = thread.changed_count; number-- > frame.first_changed;) {
    Changed& changed = thread.changed[number];
    if (changed.lane != asked || !is_same(changed.after, before)) continue;
    changed.after = after;
    return;
  }
  if (thread.changed_count < Thread::most_changed) thread.changed[thread.changed_count++] = {asked, before, after};
}

template <std::size_t number>
void wrapper(const RTCFilterFunctionNArguments* arguments) {
  const RTCFilterFunctionN filter = filters[number].load(std::memory_order_relaxed);
  Thread* thread = this_thread();
  Frame* frame = thread == nullptr ? nullptr : thread->frame;
  if (frame == nullptr || frame->capture == nullptr) return filter(arguments);
  constexpr unsigned widest = 16;
  if (arguments->N > widest) {
    if (ExchangeHeader* header = exchange()) add(header->lost_rejects, std::uint64_t{1});
    return filter(arguments);
  }
  int valid[widest];
  Hit before[widest];
  for (unsigned lane = 0; lane < arguments->N; lane++) {
    valid[lane] = arguments->valid[lane];
    if (valid[lane] == -1) before[lane] = candidate(*arguments, lane);
  }
  filter(arguments);
  for (unsigned lane = 0; lane < arguments->N; lane++) {
    if (valid[lane] != -1) continue;
    if (arguments->valid[lane] != -1) {
      note_reject(*frame, asked_lane(*frame, *arguments, lane), before[lane]);
    } else if (const Hit after = candidate(*arguments, lane); !is_same(before[lane], after)) {
      note_change(*frame, asked_lane(*frame, *arguments, lane), before[lane], after);
    }
  }
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
