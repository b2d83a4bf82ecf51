// How Embree 3.13.5 (Debian's libembree3, x86-64) lays out a scene and its trees in memory. Nothing here is in its headers:
// measured on 44 combinations of scenes and settings, and checked by live_bvh.cpp before any of it is followed.
#pragma once

#include <cstddef>
#include <cstdint>

namespace shim::layout {

// The only version that this layout is known of (RTC_DEVICE_PROPERTY_VERSION).
constexpr std::uint32_t version = 31305;

// What every acceleration structure starts with: the scene itself, the wrappers in its list, and the BVHs. Only the fields
// that are used have names.
struct Accel {
  std::uint64_t vtable;
  std::uint64_t unused;
  float bounds[2][2][4];  // at time 0 and 1: lower, upper; x, y, z and padding
  std::uint32_t type;
  std::uint32_t unused2;
};
static_assert(sizeof(Accel) == 88 && offsetof(Accel, bounds) == 16 && offsetof(Accel, type) == 80);

enum Type : std::uint32_t { type_group = 1, type_wrapper = 2, type_bvh4 = 3, type_bvh8 = 4 };

// A wrapper in the scene's list, up to the name of its kernel for single rays, such as "avx2::BVH8Triangle4Intersector1Moeller".
struct Wrapper {
  Accel accel;
  std::uint64_t bvh;
  std::uint64_t unused[6];
  std::uint64_t name;
};
static_assert(offsetof(Wrapper, bvh) == 88 && offsetof(Wrapper, name) == 144);

// A BVH, up to its root.
struct Bvh {
  Accel accel;
  std::uint64_t primitive_type;
  std::uint64_t device;
  std::uint64_t scene;
  std::uint64_t root;
};
static_assert(offsetof(Bvh, primitive_type) == 88 && offsetof(Bvh, root) == 112);

// Offset, in the scene, of the vector {begin, end, capacity} of pointers to wrappers. It is always walked: with a single
// accel the scene copies that one's type tag.
constexpr std::size_t scene_accels = 440;
struct Vector {
  std::uint64_t begin;
  std::uint64_t end;
  std::uint64_t capacity;
};

// A node reference: an address, and in its low 4 bits what lies there.
constexpr std::uint64_t tag_mask = 15;
enum Tag : std::uint64_t {
  tag_box = 0,
  tag_quantised = 5,
  tag_leaf = 8,  // plus the number of primitive blocks; alone, with a null address: nothing
};
constexpr std::uint64_t nothing = tag_leaf;

// An inner node of `width` children.
template <int width>
struct BoxNode {
  std::uint64_t children[width];
  float bounds[3][2][width];  // by axis: lower, upper
};
static_assert(sizeof(BoxNode<4>) == 128 && sizeof(BoxNode<8>) == 256);

// The same with boxes in 1/255 of the node's extent: lower = start + scale * number.
template <int width>
struct QuantisedNode {
  std::uint64_t children[width];
  std::uint8_t bounds[3][2][width];
  float start[3];
  float scale[3];
};
static_assert(sizeof(QuantisedNode<4>) == 80 && sizeof(QuantisedNode<8>) == 136);

// What a block has in front of its numbers, in rows of four, one a lane: the first corner and the
// edges v0 - v1 and v2 - v0 (f32 x, y, z each); all corners; or, for each corner, how many words (u32)
// it lies behind the geometry's first vertex.
enum class Contents : std::uint8_t { edges, corners, words };

// Where a block of four primitives keeps their numbers: u32 geomID[4], then u32 primID[4], -1 in a lane that is not used.
struct Block {
  const char* name;  // of the primitive type
  std::size_t bytes;
  std::size_t geometry;  // offset of geomID; primID follows
  std::uint32_t corners;
  Contents contents;
};
constexpr std::size_t block_lanes = 4;
// In the name of a kernel for geometries that move.
constexpr const char* motion_kernel = "MBIntersector";
// A block of this type is one instance: a pointer, then u32 geomID, padded.
constexpr const char* instance_name = "instance";
constexpr std::size_t instance_bytes = 16;
constexpr std::size_t instance_geometry = 8;
constexpr Block blocks[] = {
    {"triangle4", 176, 144, 3, Contents::edges}, {"triangle4v", 176, 144, 3, Contents::corners},
    {"triangle4i", 80, 48, 3, Contents::words},  {"quad4v", 224, 192, 4, Contents::corners},
    {"quad4i", 96, 64, 4, Contents::words},
};
constexpr std::size_t max_blocks = 7;
constexpr std::size_t max_leaf_bytes = max_blocks * 224;
constexpr std::uint32_t no_primitive = 0xFFFFFFFFu;

// Embree stops splitting long before.
constexpr std::uint32_t max_depth = 100;

// Entries of the stack of a traversal that are sure to be there: 1 + (width - 1) * 80, packets having
// three fewer than single rays. The kernels for AVX-512 do not look whether it is full.
constexpr std::uint32_t stack_entries(int width) noexcept {
  return 1 + (static_cast<std::uint32_t>(width) - 1) * 80;
}

}  // namespace shim::layout
