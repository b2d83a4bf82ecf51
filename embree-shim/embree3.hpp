// Embree 3's declarations, in which the preload library is written whatever the program has: from its header, or, where
// build.rs has defined EMBREE_MAJOR as 4, from Embree 4's, which lacks some and has the calls that ask with other arguments.
#pragma once

#define RTC_EXPORT_API

#if EMBREE_MAJOR == 4

// A C function has one declaration, so Embree 4's of these get names that nobody calls. preload_embree4.cpp has its own of the
// traversables', which came with 4.4.
#define rtcIntersect1 unused_rtcIntersect1
#define rtcIntersect4 unused_rtcIntersect4
#define rtcIntersect8 unused_rtcIntersect8
#define rtcIntersect16 unused_rtcIntersect16
#define rtcOccluded1 unused_rtcOccluded1
#define rtcOccluded4 unused_rtcOccluded4
#define rtcOccluded8 unused_rtcOccluded8
#define rtcOccluded16 unused_rtcOccluded16
#define rtcTraversableIntersect1 unused_rtcTraversableIntersect1
#define rtcTraversableIntersect4 unused_rtcTraversableIntersect4
#define rtcTraversableIntersect8 unused_rtcTraversableIntersect8
#define rtcTraversableIntersect16 unused_rtcTraversableIntersect16
#define rtcTraversableOccluded1 unused_rtcTraversableOccluded1
#define rtcTraversableOccluded4 unused_rtcTraversableOccluded4
#define rtcTraversableOccluded8 unused_rtcTraversableOccluded8
#define rtcTraversableOccluded16 unused_rtcTraversableOccluded16

#include <embree4/rtcore.h>

#undef rtcIntersect1
#undef rtcIntersect4
#undef rtcIntersect8
#undef rtcIntersect16
#undef rtcOccluded1
#undef rtcOccluded4
#undef rtcOccluded8
#undef rtcOccluded16
#undef rtcTraversableIntersect1
#undef rtcTraversableIntersect4
#undef rtcTraversableIntersect8
#undef rtcTraversableIntersect16
#undef rtcTraversableOccluded1
#undef rtcTraversableOccluded4
#undef rtcTraversableOccluded8
#undef rtcTraversableOccluded16

#include <cstddef>

enum RTCIntersectContextFlags { RTC_INTERSECT_CONTEXT_FLAG_COHERENT = 1 };

// It starts like this; nothing behind is looked at.
struct RTCIntersectContext {
  RTCIntersectContextFlags flags;
  RTCFilterFunctionN filter;
};
static_assert(sizeof(RTCIntersectContext) == 16 && offsetof(RTCIntersectContext, filter) == 8);

// A pointer for each field of a ray, and of its hit.
struct RTCRayNp {
  float* fields[12];
};
struct RTCRayHitNp {
  float* fields[20];
};

RTC_API void rtcIntersect1(RTCScene scene, RTCIntersectContext* context, RTCRayHit* ray);
RTC_API void rtcIntersect4(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRayHit4* rays);
RTC_API void rtcIntersect8(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRayHit8* rays);
RTC_API void rtcIntersect16(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRayHit16* rays);
RTC_API void rtcIntersect1M(RTCScene scene, RTCIntersectContext* context, RTCRayHit* rays, unsigned M, std::size_t stride);
RTC_API void rtcIntersect1Mp(RTCScene scene, RTCIntersectContext* context, RTCRayHit** rays, unsigned M);
RTC_API void rtcIntersectNM(RTCScene scene, RTCIntersectContext* context, RTCRayHitN* rays, unsigned N, unsigned M,
                            std::size_t stride);
RTC_API void rtcIntersectNp(RTCScene scene, RTCIntersectContext* context, const RTCRayHitNp* rays, unsigned N);
RTC_API void rtcOccluded1(RTCScene scene, RTCIntersectContext* context, RTCRay* ray);
RTC_API void rtcOccluded4(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRay4* rays);
RTC_API void rtcOccluded8(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRay8* rays);
RTC_API void rtcOccluded16(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRay16* rays);
RTC_API void rtcOccluded1M(RTCScene scene, RTCIntersectContext* context, RTCRay* rays, unsigned M, std::size_t stride);
RTC_API void rtcOccluded1Mp(RTCScene scene, RTCIntersectContext* context, RTCRay** rays, unsigned M);
RTC_API void rtcOccludedNM(RTCScene scene, RTCIntersectContext* context, RTCRayN* rays, unsigned N, unsigned M,
                           std::size_t stride);
RTC_API void rtcOccludedNp(RTCScene scene, RTCIntersectContext* context, const RTCRayNp* rays, unsigned N);

#else
#include <embree3/rtcore.h>
#endif
