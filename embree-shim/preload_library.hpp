// The real Embree, whose entry points this library decorates.
#pragma once

#define RTC_EXPORT_API
#include <embree3/rtcore.h>

namespace preload {

// Every function of Embree that is decorated or called.
#define PRELOAD_FUNCTIONS(X)                                                                                             \
  X(rtcNewScene) X(rtcRetainScene) X(rtcReleaseScene) X(rtcAttachGeometry) X(rtcAttachGeometryByID)                      \
  X(rtcDetachGeometry) X(rtcCommitScene) X(rtcJoinCommitScene) X(rtcSetSceneBuildQuality) X(rtcSetSceneFlags)            \
  X(rtcNewGeometry) X(rtcRetainGeometry) X(rtcReleaseGeometry) X(rtcCommitGeometry) X(rtcEnableGeometry)                 \
  X(rtcDisableGeometry) X(rtcSetGeometryTimeStepCount) X(rtcSetGeometryMask) X(rtcSetGeometryBuffer)                     \
  X(rtcSetSharedGeometryBuffer) X(rtcSetNewGeometryBuffer) X(rtcUpdateGeometryBuffer)                                    \
  X(rtcSetGeometryIntersectFilterFunction) X(rtcSetGeometryOccludedFilterFunction) X(rtcSetGeometryInstancedScene)       \
  X(rtcSetGeometryTransform) X(rtcSetGeometryTransformQuaternion) X(rtcGetGeometryTransform) X(rtcGetGeometryBufferData) \
  X(rtcGetSceneDevice) X(rtcReleaseDevice) X(rtcGetDeviceProperty) X(rtcGetSceneLinearBounds)                            \
  X(rtcIntersect1) X(rtcIntersect4) X(rtcIntersect8) X(rtcIntersect16) X(rtcIntersect1M) X(rtcIntersect1Mp)              \
  X(rtcIntersectNM) X(rtcIntersectNp) X(rtcOccluded1) X(rtcOccluded4) X(rtcOccluded8) X(rtcOccluded16)                   \
  X(rtcOccluded1M) X(rtcOccluded1Mp) X(rtcOccludedNM) X(rtcOccludedNp)

struct Library {
#define PRELOAD_MEMBER(name) decltype(&::name) name;
  PRELOAD_FUNCTIONS(PRELOAD_MEMBER)
#undef PRELOAD_MEMBER
  // Whether it is a libembree3: another one has the same names for calls with other arguments, so it is only passed on to.
  bool known;
};

// Found at the first call; ends the process when a function is nowhere, as the dynamic linker would.
const Library& real() noexcept;

}  // namespace preload
