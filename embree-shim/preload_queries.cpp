// Decorates the calls that ask, under Embree's names and with Embree 3's prototypes. Where the program has Embree 4, the same
// registers hold other things, and preload_embree4.hpp knows which.
#include "preload_call.hpp"
#include "preload_embree4.hpp"

namespace preload {
namespace {

// Rays that are asked at once. Longer streams are passed on in blocks, a multiple of every width that Embree has kernels for.
constexpr unsigned block_lanes = 1024;

bool is_coherent(const RTCIntersectContext* context) noexcept {
  return (context->flags & RTC_INTERSECT_CONTEXT_FLAG_COHERENT) != 0;
}

// Of Embree 4, or of a version whose arguments are unknown.
bool is_other() noexcept { return __builtin_expect(real().version != Version::three, 0); }

template <unsigned width, bool closest, typename Function, typename Rays>
void packet_3(Function function, const int* valid, RTCScene scene, RTCIntersectContext* context, Rays* rays) noexcept {
  if (is_other()) return embree4::packet<width, closest>(function, valid, scene, context, rays);
  Call call(scene, is_coherent(context), &context->filter);
  packet<width, closest>(call, valid, rays, [=] { function(valid, scene, context, rays); });
}

// A stream of `count` pieces of `width` rays: `at(lane, field)` counts lanes through all of them, `ask(first, count)` asks
// some of the pieces. A ray of a stream with tnear > tfar is not there.
template <bool closest, typename At, typename Ask>
void stream(RTCScene scene, RTCIntersectContext* context, unsigned width, unsigned count, At at, Ask ask) noexcept {
  Call call(scene, is_coherent(context), &context->filter);
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

void rtcIntersect1(RTCScene scene, RTCIntersectContext* context, RTCRayHit* rayhit) {
  if (is_other()) return embree4::single<true>(real().rtcIntersect1, scene, context, rayhit);
  Call call(scene, is_coherent(context), &context->filter);
  single<true>(call, rayhit, [=] { real().rtcIntersect1(scene, context, rayhit); });
}

void rtcOccluded1(RTCScene scene, RTCIntersectContext* context, RTCRay* ray) {
  if (is_other()) return embree4::single<false>(real().rtcOccluded1, scene, context, ray);
  Call call(scene, is_coherent(context), &context->filter);
  single<false>(call, ray, [=] { real().rtcOccluded1(scene, context, ray); });
}

void rtcIntersect4(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRayHit4* rayhit) {
  packet_3<4, true>(real().rtcIntersect4, valid, scene, context, rayhit);
}

void rtcIntersect8(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRayHit8* rayhit) {
  packet_3<8, true>(real().rtcIntersect8, valid, scene, context, rayhit);
}

void rtcIntersect16(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRayHit16* rayhit) {
  packet_3<16, true>(real().rtcIntersect16, valid, scene, context, rayhit);
}

void rtcOccluded4(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRay4* ray) {
  packet_3<4, false>(real().rtcOccluded4, valid, scene, context, ray);
}

void rtcOccluded8(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRay8* ray) {
  packet_3<8, false>(real().rtcOccluded8, valid, scene, context, ray);
}

void rtcOccluded16(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRay16* ray) {
  packet_3<16, false>(real().rtcOccluded16, valid, scene, context, ray);
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
