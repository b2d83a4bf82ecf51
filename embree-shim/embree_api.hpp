// Embree's header, and the only place where the shim tells Embree 3 from 4: how queries are asked. All else that the shim calls
// is the same in both (https://github.com/RenderKit/embree, doc/src/api.md, "Upgrading from Embree 3 to Embree 4"). build.rs
// defines EMBREE_MAJOR. The preload library decorates both at once, with declarations of its own (embree3.hpp, embree4.hpp).
#pragma once

#if EMBREE_MAJOR == 4
#include <embree4/rtcore.h>
#else
#include <embree3/rtcore.h>
#endif

namespace shim {

#if EMBREE_MAJOR != 4

// How rays are to be traversed, as the calls want to be told. Embree may write to it; it does not where nothing is instanced.
class Traversal {
 public:
  explicit Traversal(bool coherent) noexcept {
    rtcInitIntersectContext(&context_);
    if (coherent) context_.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  }

  void intersect(RTCScene scene, RTCRayHit* ray) noexcept { rtcIntersect1(scene, &context_, ray); }
  void occluded(RTCScene scene, RTCRay* ray) noexcept { rtcOccluded1(scene, &context_, ray); }

  // Packets: `function` is rtcIntersect or rtcOccluded with 4, 8 or 16.
  template <auto function, typename Rays>
  void intersect(const int* valid, RTCScene scene, Rays* rays) noexcept {
    function(valid, scene, &context_, rays);
  }
  template <auto function, typename Rays>
  void occluded(const int* valid, RTCScene scene, Rays* rays) noexcept {
    function(valid, scene, &context_, rays);
  }

 private:
  RTCIntersectContext context_;
};

// A ray, or a packet of `width`, with room for its hit.
template <typename RayHit, int width>
using Asked = RayHit;

#else

// The same for Embree 4, which has arguments behind the ray in place of a context before it.
class Traversal {
 public:
  explicit Traversal(bool coherent) noexcept {
    rtcInitIntersectArguments(&intersect_);
    rtcInitOccludedArguments(&occluded_);
    if (coherent) intersect_.flags = occluded_.flags = RTC_RAY_QUERY_FLAG_COHERENT;
  }

  void intersect(RTCScene scene, RTCRayHit* ray) noexcept { rtcIntersect1(scene, ray, &intersect_); }
  void occluded(RTCScene scene, RTCRay* ray) noexcept { rtcOccluded1(scene, ray, &occluded_); }

  template <auto function, typename Rays>
  void intersect(const int* valid, RTCScene scene, Rays* rays) noexcept {
    function(valid, scene, rays, &intersect_);
  }
  template <auto function, typename Rays>
  void occluded(const int* valid, RTCScene scene, Rays* rays) noexcept {
    function(valid, scene, rays, &occluded_);
  }

 private:
  RTCIntersectArguments intersect_;
  RTCOccludedArguments occluded_;
};

// Embree 4.3 has put a field behind the last one of a hit. Headers of 4.2 do not know it, but a library of 4.3 or later, which
// has the same name, writes it: so there is room for it, whatever the headers are.
template <typename RayHit, int width>
struct Asked : RayHit {
  unsigned int room[width];
};

#endif

}  // namespace shim
