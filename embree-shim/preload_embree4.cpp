// Queries of a scene's traversable, which Embree 4.4 brought. It is the scene, by another type, and Embree's own functions go
// on to those of scenes; so these go on to the decorated ones.
#include "preload_embree4.hpp"

namespace {

using preload::real;

RTCScene scene_of(void* traversable) noexcept { return static_cast<RTCScene>(traversable); }

}  // namespace

#define TRAVERSABLE extern "C" __attribute__((visibility("default"))) void

TRAVERSABLE rtcTraversableIntersect1(void* traversable, void* rayhit, void* arguments) {
  embree4::single<true>(real().rtcIntersect1, scene_of(traversable), rayhit, arguments);
}

TRAVERSABLE rtcTraversableIntersect4(const int* valid, void* traversable, void* rayhit, void* arguments) {
  embree4::packet<4, true>(real().rtcIntersect4, valid, scene_of(traversable), rayhit, arguments);
}

TRAVERSABLE rtcTraversableIntersect8(const int* valid, void* traversable, void* rayhit, void* arguments) {
  embree4::packet<8, true>(real().rtcIntersect8, valid, scene_of(traversable), rayhit, arguments);
}

TRAVERSABLE rtcTraversableIntersect16(const int* valid, void* traversable, void* rayhit, void* arguments) {
  embree4::packet<16, true>(real().rtcIntersect16, valid, scene_of(traversable), rayhit, arguments);
}

TRAVERSABLE rtcTraversableOccluded1(void* traversable, void* ray, void* arguments) {
  embree4::single<false>(real().rtcOccluded1, scene_of(traversable), ray, arguments);
}

TRAVERSABLE rtcTraversableOccluded4(const int* valid, void* traversable, void* ray, void* arguments) {
  embree4::packet<4, false>(real().rtcOccluded4, valid, scene_of(traversable), ray, arguments);
}

TRAVERSABLE rtcTraversableOccluded8(const int* valid, void* traversable, void* ray, void* arguments) {
  embree4::packet<8, false>(real().rtcOccluded8, valid, scene_of(traversable), ray, arguments);
}

TRAVERSABLE rtcTraversableOccluded16(const int* valid, void* traversable, void* ray, void* arguments) {
  embree4::packet<16, false>(real().rtcOccluded16, valid, scene_of(traversable), ray, arguments);
}
