// A tree on its way out: boxes, and nodes in the order of the files.
#include "tree.hpp"

#include <algorithm>
#include <limits>

namespace shim {

Bounds Bounds::empty() noexcept {
  constexpr float infinity = std::numeric_limits<float>::infinity();
  return {{infinity, infinity, infinity}, {-infinity, -infinity, -infinity}};
}

void Bounds::extend(const Bounds& other) noexcept {
  for (int axis = 0; axis < 3; axis++) {
    lower[axis] = std::min(lower[axis], other.lower[axis]);
    upper[axis] = std::max(upper[axis], other.upper[axis]);
  }
}

bool Bounds::contains(const Bounds& other) const noexcept {
  bool inside = true;
  for (int axis = 0; axis < 3; axis++) {
    inside = inside && lower[axis] <= other.lower[axis] && other.upper[axis] <= upper[axis];
  }
  return inside;
}

bool Bounds::overlaps(const Bounds& other) const noexcept {
  bool overlap = true;
  for (int axis = 0; axis < 3; axis++) {
    overlap = overlap && lower[axis] <= other.upper[axis] && other.lower[axis] <= upper[axis];
  }
  return overlap;
}

bool Bounds::is_proper() const noexcept {
  return lower[0] <= upper[0] && lower[1] <= upper[1] && lower[2] <= upper[2];
}

bool Bounds::operator==(const Bounds& other) const noexcept {
  return std::equal(lower, lower + 3, other.lower) && std::equal(upper, upper + 3, other.upper);
}

Bounds triangle_bounds(const Scene& scene, const Part& part, std::uint64_t face, std::uint32_t half) noexcept {
  Bounds bounds = Bounds::empty();
  for (const std::uint32_t corner : part.corners_of(half)) {
    const float* position = scene.vertex(part.indices[face * part.corners + corner]);
    for (int axis = 0; axis < 3; axis++) {
      bounds.lower[axis] = std::min(bounds.lower[axis], position[axis]);
      bounds.upper[axis] = std::max(bounds.upper[axis], position[axis]);
    }
  }
  return bounds;
}

std::uint32_t Tree::make_inner(std::uint32_t parent, std::uint32_t count) {
  const auto first = static_cast<std::uint32_t>(nodes.size());
  nodes.resize(nodes.size() + count);
  nodes[parent].first = first;
  nodes[parent].count = count;
  return first;
}

void Tree::make_leaf(std::uint32_t node) noexcept {
  nodes[node].first = static_cast<std::uint32_t>(primitives.size());
  nodes[node].count = leaf_bit;
}

void Tree::add_primitive(std::uint32_t node, std::uint32_t triangle) {
  primitives.push_back(triangle);
  nodes[node].count++;
}

void Tree::set_bounds(std::uint32_t node, const Bounds& bounds) noexcept {
  std::copy(bounds.lower, bounds.lower + 3, nodes[node].lower);
  std::copy(bounds.upper, bounds.upper + 3, nodes[node].upper);
}

Bounds Tree::bounds(std::uint32_t node) const noexcept {
  Bounds bounds;
  std::copy(nodes[node].lower, nodes[node].lower + 3, bounds.lower);
  std::copy(nodes[node].upper, nodes[node].upper + 3, bounds.upper);
  return bounds;
}

std::string library_name(std::uint32_t version) {
  return "embree " + std::to_string(version / 10000) + "." + std::to_string(version / 100 % 100) + "." +
         std::to_string(version % 100);
}

}  // namespace shim
