// Decorates the calls that ask: the ray as it is asked -> Embree -> a record of ray and answer in the thread's slot.
//
// All forms of a ray, one, packets and streams, have their fields in the same order, so that one template serves them: it is
// given where field f of lane i stands. The program's memory is read, never written, but for a context's filter.
#include <algorithm>

#include "preload_filters.hpp"
#include "preload_thread.hpp"

namespace preload {
namespace {

// Rays that are asked at once. Longer streams are passed on in blocks, a multiple of every width that Embree has kernels for.
constexpr unsigned block_lanes = 1024;

// A call under way; `recorded` says whether it is one to record.
class Call {
 public:
  Call(RTCScene scene, RTCIntersectContext* context) noexcept {
    if (__builtin_expect(exchange() == nullptr || !real().known, 0)) return;
    Thread* thread = this_thread();
    if (thread == nullptr) return;
    const Thread::Known* known = thread->find(scene);
    if (known == nullptr) {
      if (ExchangeHeader* header = exchange()) add(header->unnumbered, std::uint64_t{1});
      return;
    }
    // The thread may forget the scene before the call ends: callbacks ask, too.
    scene_ = *known;
    coherent_ = (context->flags & RTC_INTERSECT_CONTEXT_FLAG_COHERENT) != 0;
    // It stays: threads may share a context.
    if (context->filter != nullptr) context->filter = wrapped(context->filter);
    frame_ = {thread, scene_.capture, thread->frame, thread->rejected_count, 1, nullptr, nullptr};
    thread->frame = &frame_;
  }

  ~Call() {
    if (frame_.thread == nullptr) return;
    frame_.thread->rejected_count = frame_.first_rejected;
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
    preload::record(thread, scene_, closest, coherent_, at, asked_tfar, geometry_before, thread.rejected + first,
                    next_ - first);
  }

  template <typename At>
  void record_single(bool closest, At at, float asked_tfar, std::uint32_t geometry_before) noexcept {
    next_ = frame_.first_rejected;
    record(0, closest, at, asked_tfar, geometry_before);
  }

  // Before the next block.
  void forget_rejects() noexcept { frame_.thread->rejected_count = frame_.first_rejected; }

 private:
  Frame frame_{};
  Thread::Known scene_{};
  std::uint32_t next_ = 0;
  bool coherent_ = false;
};

const float* field_of(const void* ray, unsigned field) noexcept { return static_cast<const float*>(ray) + field; }

void intersect_1(RTCScene scene, RTCIntersectContext* context, RTCRayHit* rayhit) noexcept {
  // Of another version, whose arguments are others.
  if (__builtin_expect(!real().known, 0)) return real().rtcIntersect1(scene, context, rayhit);
  Call call(scene, context);
  const float asked_tfar = rayhit->ray.tfar;
  const std::uint32_t before = rayhit->hit.geomID;
  real().rtcIntersect1(scene, context, rayhit);
  if (call.recorded()) call.record_single(true, [rayhit](unsigned f) { return field_of(rayhit, f); }, asked_tfar, before);
}

void occluded_1(RTCScene scene, RTCIntersectContext* context, RTCRay* ray) noexcept {
  if (__builtin_expect(!real().known, 0)) return real().rtcOccluded1(scene, context, ray);
  Call call(scene, context);
  const float asked_tfar = ray->tfar;
  real().rtcOccluded1(scene, context, ray);
  if (call.recorded()) call.record_single(false, [ray](unsigned f) { return field_of(ray, f); }, asked_tfar, 0);
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
  call.forget_rejects();
}

template <unsigned width, bool closest, typename Ask>
void packet(const int* valid, RTCScene scene, RTCIntersectContext* context, const void* rays, Ask ask) noexcept {
  Call call(scene, context);
  if (!call.recorded()) return ask();
  const auto at = [rays](unsigned lane, unsigned field) { return field_of(rays, field * width + lane); };
  ask_block<width, closest>(call, width, at, [valid](unsigned lane) { return valid[lane] == -1; }, ask);
}

// A stream of `count` pieces of `width` rays: `at(lane, field)` counts lanes through all of them, `ask(first, count)` asks
// some of the pieces. A ray of a stream with tnear > tfar is not there.
template <bool closest, typename At, typename Ask>
void stream(RTCScene scene, RTCIntersectContext* context, unsigned width, unsigned count, At at, Ask ask) noexcept {
  Call call(scene, context);
  if (!call.recorded()) return ask(0, count);
  if (width > block_lanes) {
    if (ExchangeHeader* header = exchange()) add(header->unrecorded, std::uint64_t{width} * count);
    return ask(0, count);
  }
  const unsigned pieces = block_lanes / std::max(width, 1u);
  for (unsigned first = 0; first < count; first += pieces) {
    const unsigned now = std::min(pieces, count - first);
    const unsigned before = first * width;
    const auto here = [&](unsigned lane, unsigned field) { return at(before + lane, field); };
    const auto active = [&](unsigned lane) {
      const auto ray = [&](unsigned field) { return here(lane, field); };
      return value<float>(ray, tnear) <= value<float>(ray, tfar);
    };
    ask_block<block_lanes, closest>(call, now * width, here, active, [&] { ask(first, now); });
  }
}

template <typename T>
T* moved(T* start, std::size_t bytes) noexcept {
  return reinterpret_cast<T*>(reinterpret_cast<char*>(start) + bytes);
}

template <bool closest, typename Ray, typename Function>
void stream_1m(Function function, RTCScene scene, RTCIntersectContext* context, Ray* rays, unsigned count,
               std::size_t stride) noexcept {
  stream<closest>(
      scene, context, 1, count, [=](unsigned lane, unsigned field) { return field_of(moved(rays, lane * stride), field); },
      [=](unsigned first, unsigned now) { function(scene, context, moved(rays, first * stride), now, stride); });
}

template <bool closest, typename Ray, typename Function>
void stream_1mp(Function function, RTCScene scene, RTCIntersectContext* context, Ray** rays, unsigned count) noexcept {
  stream<closest>(
      scene, context, 1, count, [=](unsigned lane, unsigned field) { return field_of(rays[lane], field); },
      [=](unsigned first, unsigned now) { function(scene, context, rays + first, now); });
}

template <bool closest, typename Rays, typename Function>
void stream_nm(Function function, RTCScene scene, RTCIntersectContext* context, Rays* rays, unsigned width, unsigned count,
               std::size_t stride) noexcept {
  stream<closest>(
      scene, context, width, count,
      [=](unsigned lane, unsigned field) {
        return field_of(moved(rays, lane / width * stride), field * width + lane % width);
      },
      [=](unsigned first, unsigned now) { function(scene, context, moved(rays, first * stride), width, now, stride); });
}

// The pointers of a structure of arrays, all of the same kind of size, moved on by some rays.
template <bool closest, typename Pointers, typename Function>
void stream_np(Function function, RTCScene scene, RTCIntersectContext* context, const Pointers* rays, unsigned count) noexcept {
  constexpr std::size_t fields = sizeof(Pointers) / sizeof(float*);
  const auto pointer = [](const Pointers* from, std::size_t field) {
    float* found;
    std::memcpy(&found, reinterpret_cast<const char*>(from) + field * sizeof found, sizeof found);
    return found;
  };
  stream<closest>(
      scene, context, 1, count,
      [=](unsigned lane, unsigned field) { return static_cast<const float*>(pointer(rays, field) + lane); },
      [=](unsigned first, unsigned now) {
        Pointers here;
        for (std::size_t field = 0; field < fields; field++) {
          float* start = pointer(rays, field);
          // Fields that a program leaves out are null.
          if (start != nullptr) start += first;
          std::memcpy(reinterpret_cast<char*>(&here) + field * sizeof start, &start, sizeof start);
        }
        function(scene, context, &here, now);
      });
}

}  // namespace
}  // namespace preload

using namespace preload;

// The decorated calls, under Embree's names and with its prototypes.

void rtcIntersect1(RTCScene scene, RTCIntersectContext* context, RTCRayHit* rayhit) { intersect_1(scene, context, rayhit); }

void rtcOccluded1(RTCScene scene, RTCIntersectContext* context, RTCRay* ray) { occluded_1(scene, context, ray); }

void rtcIntersect4(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRayHit4* rayhit) {
  packet<4, true>(valid, scene, context, rayhit, [=] { real().rtcIntersect4(valid, scene, context, rayhit); });
}

void rtcIntersect8(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRayHit8* rayhit) {
  packet<8, true>(valid, scene, context, rayhit, [=] { real().rtcIntersect8(valid, scene, context, rayhit); });
}

void rtcIntersect16(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRayHit16* rayhit) {
  packet<16, true>(valid, scene, context, rayhit, [=] { real().rtcIntersect16(valid, scene, context, rayhit); });
}

void rtcOccluded4(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRay4* ray) {
  packet<4, false>(valid, scene, context, ray, [=] { real().rtcOccluded4(valid, scene, context, ray); });
}

void rtcOccluded8(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRay8* ray) {
  packet<8, false>(valid, scene, context, ray, [=] { real().rtcOccluded8(valid, scene, context, ray); });
}

void rtcOccluded16(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRay16* ray) {
  packet<16, false>(valid, scene, context, ray, [=] { real().rtcOccluded16(valid, scene, context, ray); });
}

void rtcIntersect1M(RTCScene scene, RTCIntersectContext* context, RTCRayHit* rayhit, unsigned int M, size_t byteStride) {
  stream_1m<true>(real().rtcIntersect1M, scene, context, rayhit, M, byteStride);
}

void rtcOccluded1M(RTCScene scene, RTCIntersectContext* context, RTCRay* ray, unsigned int M, size_t byteStride) {
  stream_1m<false>(real().rtcOccluded1M, scene, context, ray, M, byteStride);
}

void rtcIntersect1Mp(RTCScene scene, RTCIntersectContext* context, RTCRayHit** rayhit, unsigned int M) {
  stream_1mp<true>(real().rtcIntersect1Mp, scene, context, rayhit, M);
}

void rtcOccluded1Mp(RTCScene scene, RTCIntersectContext* context, RTCRay** ray, unsigned int M) {
  stream_1mp<false>(real().rtcOccluded1Mp, scene, context, ray, M);
}

void rtcIntersectNM(RTCScene scene, RTCIntersectContext* context, RTCRayHitN* rayhit, unsigned int N, unsigned int M,
                    size_t byteStride) {
  stream_nm<true>(real().rtcIntersectNM, scene, context, rayhit, N, M, byteStride);
}

void rtcOccludedNM(RTCScene scene, RTCIntersectContext* context, RTCRayN* ray, unsigned int N, unsigned int M,
                   size_t byteStride) {
  stream_nm<false>(real().rtcOccludedNM, scene, context, ray, N, M, byteStride);
}

void rtcIntersectNp(RTCScene scene, RTCIntersectContext* context, const RTCRayHitNp* rayhit, unsigned int N) {
  stream_np<true>(real().rtcIntersectNp, scene, context, rayhit, N);
}

void rtcOccludedNp(RTCScene scene, RTCIntersectContext* context, const RTCRayNp* ray, unsigned int N) {
  stream_np<false>(real().rtcOccludedNp, scene, context, ray, N);
}
