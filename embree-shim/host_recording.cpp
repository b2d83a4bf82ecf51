// Hooks in place of a scene's kernels -> frames, as asking.hpp has them -> the batch of the calling
// thread -> the sink.
#include "host_recording.hpp"

#include <pthread.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <list>
#include <mutex>
#include <new>
#include <string>
#include <utility>
#include <vector>

#include "asking_filters.hpp"
#include "host_filters.hpp"
#include "host_kernels.hpp"

namespace shim {
namespace {

using kernels::Context;
using kernels::Packet;
using kernels::Pair;
using kernels::Single;
using kernels::Stream;

// Scenes that can be recorded at a time.
constexpr unsigned most_recordings = 16;

// What one thread has asked one recorded scene.
struct Batch {
  explicit Batch(std::uint32_t number) : thread(number), records(SHIM_BATCH_RECORDS) {}

  std::uint32_t thread;
  std::uint32_t count = 0;
  std::vector<ShimRecord> records;
  std::vector<ShimReject> rejects;
  bool free = false;  // its thread has ended, and another may go on with it
};

// What the functions that stand in for a scene's have of it, while it is recorded.
struct Recording {
  Recording(std::uint64_t number, const HostNumbering& numbers, const ShimHostSink& to)
      : id(number), numbering(numbers), sink(to) {}

  void pass_on(Batch& batch) noexcept {
    if (batch.count != 0 && !stopped.load(std::memory_order_relaxed) &&
        sink.batch(sink.user, batch.thread, batch.records.data(), batch.count, batch.rejects.data(),
                   batch.rejects.size()) != 0) {
      stopped.store(true, std::memory_order_relaxed);
    }
    batch.count = 0;
    batch.rejects.clear();
  }

  const std::uint64_t id;  // of all that there ever were
  const HostNumbering numbering;
  const ShimHostSink sink;
  std::atomic<bool> stopped{false};
  std::atomic<std::uint64_t> unrecorded{0};
  std::atomic<std::uint64_t> lost_rejects{0};
  std::atomic<std::uint64_t> interrupted{0};
  // Guarded by the table's lock.
  std::list<Batch> batches;
};

// The kernels of a scene.
struct Kernels {
  Pair<Single> single;
  Pair<Packet> packets[3];
  Pair<Stream> stream;
};

// Rays of a packet of a stream, by whether the stream is coherent and asks for the closest hit; 0
// where that is not known.
using StreamWidths = std::array<std::array<unsigned, 2>, 2>;

// A place for a recorded scene. What its hooks ask stays when the recording ends.
struct Slot {
  std::atomic<Recording*> recording{nullptr};
  Kernels kernels{};
  StreamWidths stream_widths{};
  bool taken = false;
};

struct Slots {
  std::mutex lock;
  Slot slots[most_recordings];
  std::uint64_t next_id = 1;
};

Slots& slots() noexcept;

// A forked child asks Embree, and records nothing: its parent's file is not its own.
Slots* make_slots() {
  auto made = std::make_unique<Slots>();
  pthread_atfork([] { slots().lock.lock(); }, [] { slots().lock.unlock(); },
                 [] {
                   for (Slot& slot : slots().slots)
                     slot.recording.store(nullptr, std::memory_order_relaxed);
                   slots().lock.unlock();
                 });
  return made.release();
}

// Never freed: threads may end after everything else has.
Slots& slots() noexcept {
  static Slots* const made = make_slots();
  return *made;
}

// Of the calling thread, made at its first query of a recorded scene.
struct Thread {
  struct Known {
    std::uint64_t recording = 0;
    Batch* batch = nullptr;
  };

  asking::Candidates candidates{};
  Known known[most_recordings];
  std::uint32_t path = no_path;
  std::uint8_t depth = no_depth;
  std::uint8_t purpose = purpose_unknown;

  // The thread ends: what it has asked stays, and another thread may go on with its batches.
  ~Thread() {
    const std::lock_guard<std::mutex> lock(slots().lock);
    for (unsigned slot = 0; slot < most_recordings; slot++) {
      const Recording* recording = slots().slots[slot].recording.load(std::memory_order_relaxed);
      if (recording != nullptr && recording->id == known[slot].recording)
        known[slot].batch->free = true;
    }
  }

  // Throws std::bad_alloc.
  Batch& batch_of(unsigned slot, Recording& recording) {
    Known& here = known[slot];
    if (__builtin_expect(here.recording == recording.id, 1)) return *here.batch;
    const std::lock_guard<std::mutex> lock(slots().lock);
    for (Batch& batch : recording.batches) {
      if (!batch.free) continue;
      batch.free = false;
      here = {recording.id, &batch};
      return batch;
    }
    here = {recording.id,
            &recording.batches.emplace_back(static_cast<std::uint32_t>(recording.batches.size()))};
    return *here.batch;
  }
};

// Throws std::bad_alloc.
Thread& this_thread() {
  static thread_local std::unique_ptr<Thread> thread;
  if (thread == nullptr) thread = std::make_unique<Thread>();
  return *thread;
}

// What hooks tell while a scene's kernels are being tried, before it is recorded.
struct Trial {
  const void* scene;
  const RTCIntersectContext* user;
  unsigned lanes;
  bool as_expected;
  unsigned stream_width;
};

// Rays of a trial: few enough to be in one packet, and each with an origin of its own.
constexpr unsigned trial_lanes = 4;
constexpr float trial_origin(unsigned lane, unsigned axis) noexcept {
  return static_cast<float>(100 * axis + lane);
}

Trial*& trial() noexcept {
  static thread_local Trial* trial = nullptr;
  return trial;
}

void tell_trial(const Context* context, unsigned lanes) noexcept {
  Trial* told = trial();
  if (told == nullptr) return;
  told->as_expected =
      told->as_expected && context->scene == told->scene && context->user == told->user;
  told->lanes += lanes;
}

unsigned count_lanes(const int* valid, unsigned width) noexcept {
  unsigned count = 0;
  for (unsigned lane = 0; lane < width; lane++) count += valid[lane] == -1 ? 1 : 0;
  return count;
}

// A call that is recorded. The context's filter is watched through a copy of it, which the filter
// itself does not see: threads may share a context, and a program finds more of its own behind it.
class Call final : public FilterWatch {
 public:
  Call(Recording& recording, Thread& thread, Batch& batch, const Context& context)
      : recording_(recording),
        thread_(thread),
        batch_(batch),
        outer_(filter_watch()),
        user_(context.user),
        context_{context.scene, context.user} {
    frame_.begin(thread.candidates);
    coherent_ = (user_->flags & RTC_INTERSECT_CONTEXT_FLAG_COHERENT) != 0;
    if (user_->filter != nullptr) {
      copy_ = *user_;
      copy_.filter = &Call::see_of_context;
      context_.user = &copy_;
    }
    filter_watch() = this;
  }
  ~Call() override {
    frame_.forget();
    filter_watch() = outer_;
  }
  Call(const Call&) = delete;
  Call& operator=(const Call&) = delete;

  Context* context() noexcept { return &context_; }

  void see(const RTCFilterFunctionNArguments& arguments, RTCFilterFunctionN filter) override {
    RTCFilterFunctionNArguments as_asked = arguments;
    // Embree 4 has another name for its type.
    using AsSeen = decltype(as_asked.context);
    if (as_asked.context == reinterpret_cast<AsSeen>(&copy_)) {
      as_asked.context = reinterpret_cast<AsSeen>(user_);
    }
    const std::uint64_t lost = asking::watch(frame_, recording_.numbering, as_asked, filter);
    if (lost != 0) recording_.lost_rejects.fetch_add(lost, std::memory_order_relaxed);
  }

  bool is_coherent() const noexcept { return coherent_; }
  void leave_out(std::uint64_t queries) noexcept {
    recording_.unrecorded.fetch_add(queries, std::memory_order_relaxed);
  }

  // For asking.hpp.
  bool recorded() const noexcept { return true; }
  asking::Frame& frame() noexcept { return frame_; }

  template <typename At>
  void record(unsigned lane, bool closest, At at, float asked_tfar,
              std::uint32_t geometry_before) noexcept {
    std::uint32_t count = 0;
    const asking::Rejected* rejects = frame_.take_rejects(lane, count);
    ShimRecord& record = batch_.records[batch_.count];
    record.path = thread_.path;
    record.depth = thread_.depth;
    record.purpose = thread_.purpose;
    const bool interrupted = asking::answer(record, frame_, recording_.numbering, lane, closest,
                                            coherent_, at, asked_tfar, geometry_before, count != 0);
    if (interrupted) recording_.interrupted.fetch_add(1, std::memory_order_relaxed);
    try {
      for (std::uint32_t reject = 0; reject < count; reject++)
        batch_.rejects.push_back({batch_.count, rejects[reject].triangle});
    } catch (const std::bad_alloc&) {
      // The record goes, and its rejects with it.
      while (!batch_.rejects.empty() && batch_.rejects.back().record == batch_.count)
        batch_.rejects.pop_back();
      recording_.unrecorded.fetch_add(1, std::memory_order_relaxed);
      return;
    }
    if (++batch_.count == SHIM_BATCH_RECORDS) recording_.pass_on(batch_);
  }

 private:
  // The filter of a context that was copied: of the innermost call, as only that one's context is
  // Embree's.
  static void see_of_context(const RTCFilterFunctionNArguments* arguments) {
    auto& call = static_cast<Call&>(*filter_watch());
    call.see(*arguments, call.user_->filter);
  }

  Recording& recording_;
  Thread& thread_;
  Batch& batch_;
  FilterWatch* outer_;
  RTCIntersectContext* user_;
  RTCIntersectContext copy_{};
  Context context_;
  asking::Frame frame_;
  bool coherent_ = false;
};

// Has `recorded` ask, when the scene is being recorded, and `plain` otherwise.
template <typename Plain, typename Recorded>
void ask(unsigned slot, const Context* context, unsigned lanes, Plain plain, Recorded recorded) {
  Recording* recording = slots().slots[slot].recording.load(std::memory_order_acquire);
  if (recording == nullptr) {
    tell_trial(context, lanes);
    return plain();
  }
  if (recording->stopped.load(std::memory_order_relaxed)) return plain();
  Thread* thread = nullptr;
  Batch* batch = nullptr;
  try {
    thread = &this_thread();
    batch = &thread->batch_of(slot, *recording);
  } catch (const std::bad_alloc&) {
    recording->unrecorded.fetch_add(lanes, std::memory_order_relaxed);
  }
  if (batch == nullptr) return plain();
  Call call(*recording, *thread, *batch, *context);
  recorded(call);
}

template <unsigned slot, bool closest>
void hook_single(void* self, void* ray, Context* context) {
  const Kernels& kernels = slots().slots[slot].kernels;
  const Single kernel = closest ? kernels.single.intersect : kernels.single.occluded;
  ask(
      slot, context, 1, [&] { kernel(self, ray, context); },
      [&](Call& call) {
        asking::single<closest>(call, ray, [&] { kernel(self, ray, call.context()); });
      });
}

template <unsigned slot, unsigned index, bool closest>
void hook_packet(const int* valid, void* self, void* rays, Context* context) {
  constexpr unsigned width = 4u << index;
  const Pair<Packet>& kernels = slots().slots[slot].kernels.packets[index];
  const Packet kernel = closest ? kernels.intersect : kernels.occluded;
  ask(
      slot, context, count_lanes(valid, width), [&] { kernel(valid, self, rays, context); },
      [&](Call& call) {
        asking::packet<width, closest>(call, valid, rays,
                                       [&] { kernel(valid, self, rays, call.context()); });
      });
}

// How many rays a packet of a stream has, seen from the first one of a trial; 0 when it is none of
// those.
unsigned stream_width(const void* packet) noexcept {
  // No narrower than what has been ruled out, so that nothing behind the packet is read.
  for (const unsigned width : {4u, 8u, 16u}) {
    bool fits = true;
    for (unsigned axis = 0; axis < 3; axis++) {
      for (unsigned lane = 0; lane < trial_lanes; lane++) {
        fits = fits && *asking::field_of(packet, axis * width + lane) == trial_origin(lane, axis);
      }
    }
    if (fits) return width;
  }
  return 0;
}

// Rays of a stream that are recorded, and of the narrowest of its packets.
constexpr std::size_t most_of_stream = 1024;
constexpr std::size_t narrowest_packet = 4;

// Streams come as pointers to packets, all but the last of which are full. Rays that are not there
// have tnear > tfar.
template <bool closest, typename Ask>
void ask_stream(Call& call, void** packets, std::size_t count, unsigned width, Ask kernel) {
  if (width == 0 || count > most_of_stream) {
    call.leave_out(count);
    return kernel();
  }
  // The kernel may change their order.
  std::array<const void*, most_of_stream / narrowest_packet> as_asked;
  std::copy(packets, packets + (count + width - 1) / width, as_asked.begin());
  const auto at = [&](unsigned lane, unsigned field) {
    return asking::field_of(as_asked[lane / width], field * width + lane % width);
  };
  const auto active = [&](unsigned lane) {
    const auto ray = [&](unsigned field) { return at(lane, field); };
    return asking::value<float>(ray, asking::tnear) <= asking::value<float>(ray, asking::tfar);
  };
  asking::ask_block<most_of_stream, closest>(call, static_cast<unsigned>(count), at, active,
                                             kernel);
}

template <unsigned slot, bool closest>
void hook_stream(void* self, void** packets, std::size_t count, Context* context) {
  const Slot& here = slots().slots[slot];
  const Stream kernel = closest ? here.kernels.stream.intersect : here.kernels.stream.occluded;
  if (Trial* told = trial()) told->stream_width = stream_width(packets[0]);
  ask(
      slot, context, static_cast<unsigned>(count), [&] { kernel(self, packets, count, context); },
      [&](Call& call) {
        const unsigned width = here.stream_widths[call.is_coherent() ? 1 : 0][closest ? 1 : 0];
        ask_stream<closest>(call, packets, count, width,
                            [&] { kernel(self, packets, count, call.context()); });
      });
}

template <unsigned slot>
constexpr Kernels hooks_of() {
  return {{&hook_single<slot, true>, &hook_single<slot, false>},
          {{&hook_packet<slot, 0, true>, &hook_packet<slot, 0, false>},
           {&hook_packet<slot, 1, true>, &hook_packet<slot, 1, false>},
           {&hook_packet<slot, 2, true>, &hook_packet<slot, 2, false>}},
          {&hook_stream<slot, true>, &hook_stream<slot, false>}};
}

template <std::size_t... numbers>
Kernels hooks(unsigned slot, std::index_sequence<numbers...>) noexcept {
  static constexpr Kernels all[] = {hooks_of<numbers>()...};
  return all[slot];
}

// Calls `visit` with each function of a scene's table, the one of `hooks` that stands in for it,
// and the one that it was.
template <typename Visit>
void each_kernel(kernels::Table& table, const Kernels& hooks, Kernels& before, Visit visit) {
  const auto pair = [&](auto& here, auto& hook, auto& was) {
    visit(&here.intersect, hook.intersect, was.intersect);
    visit(&here.occluded, hook.occluded, was.occluded);
  };
  pair(table.single, hooks.single, before.single);
  pair(table.packet4.functions, hooks.packets[0], before.packets[0]);
  pair(table.packet8.functions, hooks.packets[1], before.packets[1]);
  pair(table.packet16.functions, hooks.packets[2], before.packets[2]);
  pair(table.stream.functions, hooks.stream, before.stream);
}

template <typename Function>
void store(Function* place, Function function) noexcept {
  __atomic_store_n(place, function, __ATOMIC_RELEASE);
}

// Rays with mask 0, which no geometry meets.
template <typename Rays>
void make_unseen(Rays& rays, unsigned width) noexcept {
  auto* fields = reinterpret_cast<float*>(&rays);
  for (unsigned lane = 0; lane < width; lane++) {
    for (unsigned axis = 0; axis < 3; axis++)
      fields[axis * width + lane] = trial_origin(lane, axis);
    fields[asking::direction * width + lane] = 1.0f;
    fields[asking::tfar * width + lane] = 1.0f;
  }
}

// Whether every call of Embree's reaches the hooks of a scene, with what they expect.
class TryOut {
 public:
  explicit TryOut(RTCScene scene) : scene_(scene), trial_{scene, &context_, 0, true, 0} {
    trial() = &trial_;
  }
  ~TryOut() { trial() = nullptr; }
  TryOut(const TryOut&) = delete;
  TryOut& operator=(const TryOut&) = delete;

  bool calls_are_as_expected() {
    RTCRayHit hit{};
    RTCRayHit4 hits4{};
    RTCRayHit8 hits8{};
    RTCRayHit16 hits16{};
    RTCRay ray{};
    RTCRay4 rays4{};
    RTCRay8 rays8{};
    RTCRay16 rays16{};
    bool good = true;
    const auto ask = [&](unsigned width, auto& rays, auto function) {
      make_unseen(rays, width);
      good = reach(width, [&] { function(valid_, scene_, &context_, &rays); }) && good;
    };
    ask(1, hit, [](const int*, RTCScene scene, RTCIntersectContext* context, RTCRayHit* asked) {
      rtcIntersect1(scene, context, asked);
    });
    ask(1, ray, [](const int*, RTCScene scene, RTCIntersectContext* context, RTCRay* asked) {
      rtcOccluded1(scene, context, asked);
    });
    ask(4, hits4, &rtcIntersect4);
    ask(8, hits8, &rtcIntersect8);
    ask(16, hits16, &rtcIntersect16);
    ask(4, rays4, &rtcOccluded4);
    ask(8, rays8, &rtcOccluded8);
    ask(16, rays16, &rtcOccluded16);
    return good;
  }

  StreamWidths stream_widths() {
    StreamWidths widths{};
#if EMBREE_MAJOR != 4
    // Embree 4 has no streams, and its scenes have been refused before.
    const auto ask = [&](bool coherent, bool closest, auto& rays, auto function) {
      for (unsigned lane = 0; lane < trial_lanes; lane++) {
        make_unseen(rays[lane], 1);
        auto* fields = reinterpret_cast<float*>(&rays[lane]);
        for (unsigned axis = 0; axis < 3; axis++) fields[axis] = trial_origin(lane, axis);
      }
      context_.flags =
          static_cast<RTCIntersectContextFlags>(coherent ? RTC_INTERSECT_CONTEXT_FLAG_COHERENT : 0);
      trial_.stream_width = 0;
      const bool good = reach(
          trial_lanes, [&] { function(scene_, &context_, rays, trial_lanes, sizeof rays[0]); });
      widths[coherent ? 1 : 0][closest ? 1 : 0] = good ? trial_.stream_width : 0;
    };
    RTCRayHit hits[trial_lanes] = {};
    RTCRay rays[trial_lanes] = {};
    for (const bool coherent : {false, true}) {
      ask(coherent, true, hits, &rtcIntersect1M);
      ask(coherent, false, rays, &rtcOccluded1M);
    }
#endif
    return widths;
  }

 private:
  // Whether a call tells the hooks, with this context, of that many rays.
  template <typename Ask>
  bool reach(unsigned lanes, Ask ask) {
    trial_.lanes = 0;
    ask();
    return trial_.as_expected && trial_.lanes == lanes;
  }

  RTCScene scene_;
  RTCIntersectContext context_{};
  alignas(64) const
      int valid_[16] = {-1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1, -1};
  Trial trial_;
};

}  // namespace

class HostRecording::Impl {
 public:
  Impl(const HostScene& scene, const HostNumbering& numbering, const ShimHostSink& sink)
      : table_(reinterpret_cast<kernels::Table*>(reinterpret_cast<char*>(scene.get()) +
                                                 kernels::table)) {
    const std::lock_guard<std::mutex> lock(slots().lock);
    while (slot_ < most_recordings && here().taken) slot_++;
    if (slot_ == most_recordings) throw Doubt("more than 16 scenes cannot be recorded at a time");
    recording_ = std::make_unique<Recording>(slots().next_id++, numbering, sink);
    check();
    place();
    TryOut trial(scene.get());
    if (!trial.calls_are_as_expected()) {
      take_back();
      throw Doubt("Embree's kernels are not called as expected");
    }
    here().stream_widths = trial.stream_widths();
    try {
      filters_ = std::make_unique<HostFilters>(scene, numbering);
    } catch (...) {
      take_back();
      throw;
    }
    here().taken = true;
    here().recording.store(recording_.get(), std::memory_order_release);
  }

  ShimHostEnd end() noexcept {
    ShimHostEnd end{};
    const std::lock_guard<std::mutex> lock(slots().lock);
    if (recording_ == nullptr) return end;
    // In a forked child there is none any more, nor what was asked.
    const bool here_still =
        here().recording.exchange(nullptr, std::memory_order_acq_rel) != nullptr;
    end.interrupted_scene = take_back() ? 0 : 1;
    filters_.reset();
    here().taken = false;
    if (here_still) {
      for (Batch& batch : recording_->batches) recording_->pass_on(batch);
    }
    end.threads = recording_->batches.size();
    end.unrecorded = recording_->unrecorded.load(std::memory_order_relaxed);
    end.lost_rejects = recording_->lost_rejects.load(std::memory_order_relaxed);
    end.interrupted = recording_->interrupted.load(std::memory_order_relaxed);
    recording_.reset();
    return end;
  }

 private:
  Slot& here() noexcept { return slots().slots[slot_]; }

  // All functions of the table are code of Embree's; that it can be read, the scene's other checks
  // have shown.
  void check() {
    const Image image = find_image();
    Kernels before{};
    each_kernel(*table_, hooks(slot_, std::make_index_sequence<most_recordings>()), before,
                [&](auto* place, auto, auto&) {
                  const auto code = reinterpret_cast<std::uintptr_t>(*place);
                  if (code != 0 && !covers(image.code, code, 1))
                    throw Doubt("a kernel of the scene is not in libembree3");
                });
  }

  void place() noexcept {
    each_kernel(*table_, hooks(slot_, std::make_index_sequence<most_recordings>()), here().kernels,
                [](auto* place, auto hook, auto& before) {
                  before = *place;
                  if (before != nullptr) store(place, hook);
                });
  }

  // Puts Embree's functions back, where a commit has not already. Returns whether all of ours were
  // there.
  bool take_back() noexcept {
    bool all = true;
    each_kernel(*table_, hooks(slot_, std::make_index_sequence<most_recordings>()), here().kernels,
                [&](auto* place, auto hook, auto& before) {
                  if (before == nullptr) return;
                  if (*place == hook) {
                    store(place, before);
                  } else {
                    all = false;
                  }
                });
    return all;
  }

  kernels::Table* table_;
  unsigned slot_ = 0;
  std::unique_ptr<Recording> recording_;
  std::unique_ptr<HostFilters> filters_;
};

HostRecording::HostRecording(const HostScene& scene, const HostNumbering& numbering,
                             const ShimHostSink& sink)
    : impl_(std::make_unique<Impl>(scene, numbering, sink)) {}

HostRecording::~HostRecording() { end(); }

ShimHostEnd HostRecording::end() noexcept { return impl_->end(); }

void label(std::uint32_t path, std::uint8_t depth, std::uint8_t purpose) noexcept {
  try {
    Thread& thread = this_thread();
    thread.path = path;
    thread.depth = depth;
    thread.purpose = purpose;
  } catch (const std::bad_alloc&) {
    // Its queries have none then.
  }
}

}  // namespace shim
