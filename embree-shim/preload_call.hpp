// A call that asks, of either version, as the preload library records it (asking.hpp). The program's memory is read, never
// written, but for a filter that a call brings.
#pragma once

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
    frame_.begin(thread->candidates);
    frame_.thread = thread;
    frame_.capture = scene_.capture;
    frame_.outer = thread->frame;
    thread->frame = &frame_;
  }

  ~Call() {
    if (frame_.thread == nullptr) return;
    frame_.forget();
    frame_.thread->frame = frame_.outer;
  }

  Call(const Call&) = delete;
  Call& operator=(const Call&) = delete;

  bool recorded() const noexcept { return frame_.thread != nullptr; }

  shim::asking::Frame& frame() noexcept { return frame_; }

  template <typename At>
  void record(unsigned lane, bool closest, At at, float asked_tfar, std::uint32_t geometry_before) noexcept {
    std::uint32_t count = 0;
    const shim::asking::Rejected* rejects = frame_.take_rejects(lane, count);
    preload::record(*frame_.thread, scene_, lane, closest, coherent_, at, asked_tfar, geometry_before, rejects, count);
  }

 private:
  Frame frame_{};
  Thread::Known scene_{};
  bool coherent_ = false;
};

using shim::asking::ask_block;
using shim::asking::field_of;
using shim::asking::packet;
using shim::asking::single;
using shim::asking::tfar;
using shim::asking::tnear;
using shim::asking::value;

}  // namespace preload
