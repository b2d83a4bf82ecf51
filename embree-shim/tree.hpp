// A tree on its way out, as the files have it; and what both sources of trees share.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "memory.hpp"
#include "scene.hpp"
#include "shim.h"

namespace shim {

constexpr std::uint32_t leaf_bit = 0x80000000u;

struct Bounds {
  float lower[3];
  float upper[3];

  // The identity of `extend`; also the box of an empty tree.
  static Bounds empty() noexcept;
  void extend(const Bounds& other) noexcept;
  bool contains(const Bounds& other) const noexcept;
  bool overlaps(const Bounds& other) const noexcept;
  // Whether lower <= upper on every axis, and none is NaN.
  bool is_proper() const noexcept;
  bool operator==(const Bounds& other) const noexcept;
};

// The box of one of a face's triangles.
Bounds triangle_bounds(const Scene& scene, const Part& part, std::uint64_t face, std::uint32_t half) noexcept;

// Nodes and primitives in the order of NODE and PRIM: children adjacent, behind their parent, depth first.
struct Tree {
  std::vector<ShimNode> nodes;
  std::vector<std::uint32_t> primitives;
  std::string producer;
  bool splits = false;  // a triangle stands in several leaves, or a leaf's box is clipped

  // Adds room for `count` adjacent children of `parent` and makes it an inner node; returns the index of the first.
  std::uint32_t make_inner(std::uint32_t parent, std::uint32_t count);
  void make_leaf(std::uint32_t node) noexcept;  // empty; `add_primitive` fills it, before any other leaf is made
  void add_primitive(std::uint32_t node, std::uint32_t triangle);
  void set_bounds(std::uint32_t node, const Bounds& bounds) noexcept;
  Bounds bounds(std::uint32_t node) const noexcept;
};

// Reads the tree that Embree traverses from its memory; throws Doubt at the first check that fails. A fault, for tests,
// falsifies what is read.
Tree read_live_tree(const Scene& scene, const ShimFault* fault);

// Builds a binary tree with one triangle a leaf with rtcBuildBVH.
Tree build_tree(const Scene& scene);

// "embree 3.13.5".
std::string library_name(std::uint32_t version);

}  // namespace shim
