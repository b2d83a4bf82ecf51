// Included before host.cpp, which is written for Embree 3, where it is to be a program of Embree 4: the calls that ask, with
// Embree 3's arguments, ask Embree 4 with its own.
#pragma once

#include <embree4.hpp>

namespace four {

// All that Embree 4 may look at.
struct Arguments {
  embree4::Arguments known;
  void* rest[4];
};

inline Arguments arguments_of(const RTCIntersectContext& context) {
  constexpr unsigned invoke_filter = 1u << 1;
  const unsigned coherent = (context.flags & RTC_INTERSECT_CONTEXT_FLAG_COHERENT) != 0 ? embree4::coherent : 0;
  return {{coherent | (context.filter != nullptr ? invoke_filter : 0), ~0u, nullptr, context.filter}, {}};
}

// Where they say nothing, there are none.
inline embree4::Arguments* none_or(Arguments& arguments) {
  return arguments.known.flags == 0 && arguments.known.filter == nullptr ? nullptr : &arguments.known;
}

template <auto function, typename Ray>
void single(RTCScene scene, RTCIntersectContext* context, Ray* ray) {
  Arguments arguments = arguments_of(*context);
  reinterpret_cast<embree4::Single>(function)(scene, ray, none_or(arguments));
}

template <auto function, typename Rays>
void packet(const int* valid, RTCScene scene, RTCIntersectContext* context, Rays* rays) {
  Arguments arguments = arguments_of(*context);
  reinterpret_cast<embree4::Packet>(function)(valid, scene, rays, &arguments.known);
}

constexpr auto intersect_1 = single<rtcIntersect1, RTCRayHit>;
constexpr auto occluded_1 = single<rtcOccluded1, RTCRay>;
constexpr auto intersect_4 = packet<rtcIntersect4, RTCRayHit4>;
constexpr auto occluded_4 = packet<rtcOccluded4, RTCRay4>;
constexpr auto intersect_8 = packet<rtcIntersect8, RTCRayHit8>;
constexpr auto occluded_8 = packet<rtcOccluded8, RTCRay8>;
constexpr auto intersect_16 = packet<rtcIntersect16, RTCRayHit16>;
constexpr auto occluded_16 = packet<rtcOccluded16, RTCRay16>;

}  // namespace four

// Embree 4.4's.
extern "C" {
RTCScene rtcGetSceneTraversable(RTCScene scene);
void rtcTraversableIntersect1(RTCScene scene, RTCIntersectContext* context, RTCRayHit* rayhit);
void rtcTraversableOccluded1(RTCScene scene, RTCIntersectContext* context, RTCRay* ray);
void rtcTraversableIntersect4(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRayHit4* rayhit);
void rtcTraversableOccluded4(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRay4* ray);
void rtcSetSharedGeometryBufferHostDevice(RTCGeometry geometry, RTCBufferType type, unsigned slot, RTCFormat format,
                                          const void* data, const void* device_data, std::size_t offset, std::size_t stride,
                                          std::size_t count);
}

namespace four {

constexpr auto traversable_intersect_1 = single<rtcTraversableIntersect1, RTCRayHit>;
constexpr auto traversable_occluded_1 = single<rtcTraversableOccluded1, RTCRay>;
constexpr auto traversable_intersect_4 = packet<rtcTraversableIntersect4, RTCRayHit4>;
constexpr auto traversable_occluded_4 = packet<rtcTraversableOccluded4, RTCRay4>;

}  // namespace four

#define rtcIntersect1 four::intersect_1
#define rtcOccluded1 four::occluded_1
#define rtcIntersect4 four::intersect_4
#define rtcOccluded4 four::occluded_4
#define rtcIntersect8 four::intersect_8
#define rtcOccluded8 four::occluded_8
#define rtcIntersect16 four::intersect_16
#define rtcOccluded16 four::occluded_16
#define EMBREE_4
