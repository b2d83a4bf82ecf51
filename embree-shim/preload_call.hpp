// A call that asks, of either version: the rays as they are asked -> Embree -> a record of each ray and its answer.
//
// All forms of a ray, one, packets and streams, have their fields in the same order, so that one template serves them: it is
// given where field f of lane i stands. The program's memory is read, never written, but for a filter that a call brings.
#pragma once

#include <algorithm>

#include "preload_filters.hpp"
#include "preload_thread.hpp"

namespace preload {

// A call under way; `recorded` says whether it is one to record.
class Call {
 public:
  // `filter` is the program's pointer to a filter for this call, if it has one.
  Call(RTCScene scene, bool coherent, RTCFilterFunctionN* filter) noexcept {
    if (__builtin_expect(exchange() == nullptr || !real().is_known(), 0)) return;
    Thread* thread = this_thread();
    if (thread == nullptr) return;
    const Thread::Known* known = thread->find(scene);
    if (known == nullptr) {
      if (ExchangeHeader* header = exchange()) add(header->unnumbered, std::uint64_t{1});
      return;
    }
    // The thread may forget the scene before the call ends: callbacks ask, too.
    scene_ = *known;
    coherent_ = coherent;
    // It stays: threads may share a context.
    if (filter != nullptr && *filter != nullptr) *filter = wrapped(*filter);
    frame_ = {thread, scene_.capture, thread->frame, thread->rejected_count, thread->changed_count, 1, nullptr, nullptr};
    thread->frame = &frame_;
  }

  ~Call() {
    if (frame_.thread == nullptr) return;
    forget();
    frame_.thread->frame = frame_.outer;
  }

  Call(const Call&) = delete;
  Call& operator=(const Call&) = delete;

  bool recorded() const noexcept { return frame_.thread != nullptr; }

  // Tells filters which rays are being asked.
  template <typename At>
  void expect(unsigned lanes, const At& at) noexcept {
    frame_.lanes = lanes;
    frame_.rays = &at;
    frame_.at = [](const void* rays, unsigned lane, unsigned field) { return (*static_cast<const At*>(rays))(lane, field); };
  }

  // Puts the rejects of a packet or block in the order of its lanes, before its records are made.
  void sort() noexcept {
    Rejected* rejected = frame_.thread->rejected;
    std::sort(rejected + frame_.first_rejected, rejected + frame_.thread->rejected_count,
              [](const Rejected& a, const Rejected& b) { return a.lane < b.lane; });
    next_ = frame_.first_rejected;
  }

  template <typename At>
  void record(unsigned lane, bool closest, At at, float asked_tfar, std::uint32_t geometry_before) noexcept {
    Thread& thread = *frame_.thread;
    const std::uint32_t first = next_;
    while (next_ < thread.rejected_count && thread.rejected[next_].lane == lane) next_++;
    preload::record(thread, scene_, lane, closest, coherent_, at, asked_tfar, geometry_before, thread.rejected + first,
                    next_ - first);
  }

  template <typename At>
  void record_single(bool closest, At at, float asked_tfar, std::uint32_t geometry_before) noexcept {
    next_ = frame_.first_rejected;
    record(0, closest, at, asked_tfar, geometry_before);
  }

  // What filters did: before the next block, and at the end.
  void forget() noexcept {
    frame_.thread->rejected_count = frame_.first_rejected;
    frame_.thread->changed_count = frame_.first_changed;
  }

 private:
  Frame frame_{};
  Thread::Known scene_{};
  std::uint32_t next_ = 0;
  bool coherent_ = false;
};

inline const float* field_of(const void* ray, unsigned field) noexcept { return static_cast<const float*>(ray) + field; }

// One ray; `closest` asks for the nearest hit, and `ask` Embree.
template <bool closest, typename Ask>
void single(Call& call, const void* ray, Ask ask) noexcept {
  const auto at = [ray](unsigned field) { return field_of(ray, field); };
  const auto asked_tfar = value<float>(at, tfar);
  const std::uint32_t before = closest ? value<std::uint32_t>(at, hit_geometry) : 0;
  ask();
  if (call.recorded()) call.record_single(closest, at, asked_tfar, before);
}

// Asks `lanes` rays with `ask`; `at(lane, field)` is where a field stands, `active(lane)` whether the ray is one.
template <unsigned most, bool closest, typename At, typename Active, typename Ask>
void ask_block(Call& call, unsigned lanes, At at, Active active, Ask ask) noexcept {
  float asked_tfar[most];
  std::uint32_t before[most];
  bool asked[most];
  for (unsigned lane = 0; lane < lanes; lane++) {
    asked[lane] = active(lane);
    std::memcpy(&asked_tfar[lane], at(lane, tfar), sizeof(float));
    if (closest) std::memcpy(&before[lane], at(lane, hit_geometry), sizeof(std::uint32_t));
  }
  call.expect(lanes, at);
  ask();
  call.sort();
  for (unsigned lane = 0; lane < lanes; lane++) {
    if (!asked[lane]) continue;
    call.record(lane, closest, [&](unsigned field) { return at(lane, field); }, asked_tfar[lane], closest ? before[lane] : 0);
  }
  call.forget();
}

template <unsigned width, bool closest, typename Ask>
void packet(Call& call, const int* valid, const void* rays, Ask ask) noexcept {
  if (!call.recorded()) return ask();
  const auto at = [rays](unsigned lane, unsigned field) { return field_of(rays, field * width + lane); };
  ask_block<width, closest>(call, width, at, [valid](unsigned lane) { return valid[lane] == -1; }, ask);
}

}  // namespace preload
