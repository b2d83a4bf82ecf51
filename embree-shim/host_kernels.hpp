// Where a committed scene of Embree 3.13.5 has the functions that answer its queries, whichever
// call asks: rtcIntersect1 and its like read them anew each time. Nothing of it is in Embree's
// headers; host_recording.cpp tries all of it on each scene before it relies on it.
#pragma once

#include <cstddef>

#include "embree3.hpp"

namespace shim::kernels {

// embree::IntersectContext, which a call makes for its kernel.
struct Context {
  const void* scene;
  RTCIntersectContext* user;
};

// `self` is the address of the table that the function stands in.
using Single = void (*)(void* self, void* ray, Context* context);
using Packet = void (*)(const int* valid, void* self, void* rays, Context* context);
// Coherent streams: pointers to rays, or to packets of them.
using Stream = void (*)(void* self, void** rays, std::size_t count, Context* context);

template <typename Function>
struct Pair {
  Function intersect;
  Function occluded;
};

// A pair and the name of the kernel; twice more for packets with and without filters.
template <typename Function>
struct Entry {
  Pair<Function> functions;
  const char* name;
  const void* unused[6];
};

// embree::Accel::Intersectors.
struct Table {
  const void* accel;
  const void* leaf;
  const void* collide[2];
  Pair<Single> single;
  const void* point_query;
  const char* single_name;
  Entry<Packet> packet4;
  Entry<Packet> packet8;
  Entry<Packet> packet16;
  Entry<Stream> stream;
};
// Offset of the table in the scene; behind it stands the list of accels (layout::scene_accels).
constexpr std::size_t table = 88;
static_assert(offsetof(Table, single) == 120 - table &&
              offsetof(Table, single_name) == 144 - table);
static_assert(offsetof(Table, packet4) == 152 - table && offsetof(Table, packet8) == 224 - table);
static_assert(offsetof(Table, packet16) == 296 - table && offsetof(Table, stream) == 368 - table);
static_assert(sizeof(Table) == 440 - table);

}  // namespace shim::kernels
