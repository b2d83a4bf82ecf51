// The real Embree, whose entry points this library decorates.
#pragma once

#include "embree4.hpp"

namespace preload {

// Functions of both versions that are decorated or called.
#define PRELOAD_FUNCTIONS(X)                                                                                             \
  X(rtcNewScene) X(rtcRetainScene) X(rtcReleaseScene) X(rtcAttachGeometry) X(rtcAttachGeometryByID)                      \
  X(rtcDetachGeometry) X(rtcCommitScene) X(rtcJoinCommitScene) X(rtcSetSceneBuildQuality) X(rtcSetSceneFlags)            \
  X(rtcNewGeometry) X(rtcRetainGeometry) X(rtcReleaseGeometry) X(rtcCommitGeometry) X(rtcEnableGeometry)                 \
  X(rtcDisableGeometry) X(rtcSetGeometryTimeStepCount) X(rtcSetGeometryMask) X(rtcSetGeometryBuffer)                     \
  X(rtcSetSharedGeometryBuffer) X(rtcSetNewGeometryBuffer) X(rtcUpdateGeometryBuffer)                                    \
  X(rtcSetGeometryIntersectFilterFunction) X(rtcSetGeometryOccludedFilterFunction) X(rtcSetGeometryInstancedScene)       \
  X(rtcSetGeometryTransform) X(rtcSetGeometryTransformQuaternion) X(rtcGetGeometryTransform) X(rtcGetGeometryBufferData) \
  X(rtcGetGeometry) X(rtcGetSceneDevice) X(rtcReleaseDevice) X(rtcGetDeviceProperty) X(rtcGetSceneLinearBounds)                            \
  X(rtcIntersect1) X(rtcIntersect4) X(rtcIntersect8) X(rtcIntersect16) X(rtcOccluded1) X(rtcOccluded4) X(rtcOccluded8)   \
  X(rtcOccluded16)

// Only Embree 3 has streams.
#define PRELOAD_STREAMS(X)                                                                                  \
  X(rtcIntersect1M) X(rtcIntersect1Mp) X(rtcIntersectNM) X(rtcIntersectNp) X(rtcOccluded1M) X(rtcOccluded1Mp) \
  X(rtcOccludedNM) X(rtcOccludedNp)

// Which Embree it is. Versions have the same names for calls with other arguments.
enum class Version { three, four, other };

struct Library {
  // With Embree 3's prototypes.
#define PRELOAD_MEMBER(name) decltype(&::name) name;
  PRELOAD_FUNCTIONS(PRELOAD_MEMBER)
  PRELOAD_STREAMS(PRELOAD_MEMBER)
#undef PRELOAD_MEMBER
  // Of Embree 4.4.
  embree4::SharedBuffer rtcSetSharedGeometryBufferHostDevice;
  embree4::NewBuffer rtcSetNewGeometryBufferHostDevice;
  Version version;

  // Another version is only passed on to.
  bool is_known() const noexcept { return version != Version::other; }
};

// Before the first call of `real`, from a function that makes what others need: where the program called it.
void called_from(const void* address) noexcept;

// Found at the first call; ends the process when a function is nowhere, as the dynamic linker would.
const Library& real() noexcept;

}  // namespace preload
