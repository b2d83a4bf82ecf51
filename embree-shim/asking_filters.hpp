// What a program's filters do to candidates of the rays that are being asked, for who stands
// between them and Embree.
#pragma once

#include "asking.hpp"

namespace shim::asking {

// Whether the ray in lane `lane` of a filter's packet is the one in lane `asked` of the call.
inline bool is_same_ray(const Frame& frame, const RTCFilterFunctionNArguments& arguments,
                        unsigned lane, unsigned asked) noexcept {
  // Origin and direction.
  for (const unsigned field : {0u, 1u, 2u, 4u, 5u, 6u}) {
    const auto* seen = reinterpret_cast<const float*>(arguments.ray) + field * arguments.N + lane;
    if (std::memcmp(seen, frame.at(frame.rays, asked, field), sizeof(float)) != 0) return false;
  }
  return true;
}

// Which of the rays that were asked lane `lane` of a filter's packet is; `lanes` when that is not
// known. Embree cuts packets and streams as it likes where it has no kernel of their width; then
// the ray itself tells, unless an instance has turned it.
inline std::uint32_t asked_lane(const Frame& frame, const RTCFilterFunctionNArguments& arguments,
                                unsigned lane) noexcept {
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
inline Hit candidate(const RTCFilterFunctionNArguments& arguments, unsigned lane) noexcept {
  // The hit stands apart, and Field counts it as if it followed the ray.
  constexpr unsigned ray_fields = 12;
  return hit_of([&](unsigned field) {
    const bool of_ray = field < ray_fields;
    const void* from = of_ray ? static_cast<const void*>(arguments.ray) : arguments.hit;
    return static_cast<const float*>(from) + (of_ray ? field : field - ray_fields) * arguments.N +
           lane;
  });
}

// Returns whether it could be noted.
template <typename Numbering>
bool note_reject(Frame& frame, const Numbering& numbering, std::uint32_t asked,
                 const Hit& hit) noexcept {
  Candidates& candidates = *frame.candidates;
  // What another filter, which was asked before, has made of it.
  if (candidates.changed_count > frame.first_changed) {
    const Changed& last = candidates.changed[candidates.changed_count - 1];
    if (last.lane == asked && is_same(last.after, hit)) {
      candidates.changed_count--;
      return note_reject(frame, numbering, asked, last.before);
    }
  }
  const std::uint32_t triangle =
      numbering.triangle(hit.instance, hit.geometry, hit.primitive, hit.u, hit.v).triangle;
  // What is not a triangle is not replayed.
  if (triangle == no_triangle) return true;
  if (asked == frame.lanes || candidates.rejected_count == Candidates::most_rejected) return false;
  // With spatial splits a candidate may come again.
  for (std::uint32_t before = frame.first_rejected; before < candidates.rejected_count; before++) {
    if (candidates.rejected[before].lane == asked &&
        candidates.rejected[before].triangle == triangle)
      return true;
  }
  candidates.rejected[candidates.rejected_count++] = {asked, triangle};
  return true;
}

inline void note_change(Frame& frame, std::uint32_t asked, const Hit& before,
                        const Hit& after) noexcept {
  Candidates& candidates = *frame.candidates;
  // A filter of the geometry, and one of the call, may both change a candidate.
  for (std::uint32_t number = candidates.changed_count; number-- > frame.first_changed;) {
    Changed& changed = candidates.changed[number];
    if (changed.lane != asked || !is_same(changed.after, before)) continue;
    changed.after = after;
    return;
  }
  if (candidates.changed_count < Candidates::most_changed) {
    candidates.changed[candidates.changed_count++] = {asked, before, after};
  }
}

// Has `filter` decide, and notes what it does. Returns how many rejects are lost.
template <typename Numbering, typename Filter>
std::uint64_t watch(Frame& frame, const Numbering& numbering,
                    const RTCFilterFunctionNArguments& arguments, Filter filter) {
  constexpr unsigned widest = 16;
  if (arguments.N > widest) {
    filter(&arguments);
    return 1;
  }
  int valid[widest];
  Hit before[widest];
  for (unsigned lane = 0; lane < arguments.N; lane++) {
    valid[lane] = arguments.valid[lane];
    if (valid[lane] == -1) before[lane] = candidate(arguments, lane);
  }
  filter(&arguments);
  std::uint64_t lost = 0;
  for (unsigned lane = 0; lane < arguments.N; lane++) {
    if (valid[lane] != -1) continue;
    if (arguments.valid[lane] != -1) {
      if (!note_reject(frame, numbering, asked_lane(frame, arguments, lane), before[lane])) lost++;
    } else if (const Hit after = candidate(arguments, lane); !is_same(before[lane], after)) {
      note_change(frame, asked_lane(frame, arguments, lane), before[lane], after);
    }
  }
  return lost;
}

}  // namespace shim::asking
