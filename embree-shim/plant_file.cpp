// GEOM and TRIS -> parts by geomID.
#include "plant_file.hpp"

#include <algorithm>
#include <string>

#include "memory.hpp"

namespace shim {
namespace {

// Values of ShimGeometry.
constexpr std::uint32_t no_instance = 0xFFFFFFFFu;
constexpr std::uint32_t kind_quads = 1;
constexpr std::uint32_t flag_moving = 1;

// Parts are an array by geomID, and Embree has one, too. A program that uses higher ones has none
// of its trees planted.
constexpr std::uint32_t most_geometries = 1u << 20;

constexpr std::size_t floats_per_triangle = 9;

bool same_vertex(const float* a, const float* b) noexcept {
  return std::memcmp(a, b, 3 * sizeof(float)) == 0;
}

}  // namespace

FileFaces::FileFaces(const ShimTreeFile& file) : owners_(file.triangle_count, none) {
  fours_.reserve(file.geometry_count);
  for (std::uint64_t row = 0; row < file.geometry_count; row++) {
    if (file.geometries[row].triangle_count != 0) add(file.geometries[row], file);
  }
}

void FileFaces::add(const ShimGeometry& geometry, const ShimTreeFile& file) {
  const std::string name = "geometry " + std::to_string(geometry.geometry);
  if (geometry.instance != no_instance) {
    throw Doubt("the file's triangles were placed by instances, and the scene has them as they are");
  }
  if (geometry.flags & flag_moving) throw Doubt("the file's " + name + " moves");
  if (geometry.kind > kind_quads) throw Doubt("the file's " + name + " is of an unknown kind");
  if (geometry.geometry >= most_geometries) {
    throw Doubt("the file's " + name + " has a number beyond a million");
  }
  const std::uint64_t end = std::uint64_t{geometry.first_triangle} + geometry.triangle_count;
  if (end > file.triangle_count) throw Doubt("the file's " + name + " has triangles that it lacks");
  const auto first = owners_.begin() + geometry.first_triangle;
  const auto last = first + geometry.triangle_count;
  if (std::any_of(first, last, [](std::uint32_t owner) { return owner != none; })) {
    throw Doubt("two geometries of the file share triangles");
  }
  std::fill(first, last, geometry.geometry);
  if (parts_.size() <= geometry.geometry) parts_.resize(std::size_t{geometry.geometry} + 1);
  Part& part = parts_[geometry.geometry];
  if (part.faces != 0) throw Doubt("the file has two geometries " + std::to_string(geometry.geometry));
  const float* vertices = file.triangles + floats_per_triangle * geometry.first_triangle;
  part.vertices = reinterpret_cast<const unsigned char*>(vertices);
  part.vertex_count = std::uint64_t{3} * geometry.triangle_count;
  part.mask = geometry.mask;
  part.first_triangle = geometry.first_triangle;
  if (geometry.kind == kind_quads) {
    add_quads(geometry, file);
    return;
  }
  part.faces = geometry.triangle_count;
}

// A quad (v0, v1, v2, v3) stands in TRIS as (v0, v1, v3) and (v2, v3, v1).
void FileFaces::add_quads(const ShimGeometry& geometry, const ShimTreeFile& file) {
  if (geometry.triangle_count % 2 != 0) throw Doubt("the file has half a quad");
  Part& part = parts_[geometry.geometry];
  part.corners = 4;
  part.faces = geometry.triangle_count / 2;
  std::vector<std::uint32_t>& corners = fours_.emplace_back();
  corners.reserve(4 * part.faces);
  for (std::uint64_t quad = 0; quad < part.faces; quad++) {
    const auto first = static_cast<std::uint32_t>(6 * quad);
    corners.insert(corners.end(), {first, first + 1, first + 3, first + 2});
  }
  part.indices = reinterpret_cast<const unsigned char*>(corners.data());
  part.index_stride = 4 * sizeof(std::uint32_t);
  const float* at = file.triangles + floats_per_triangle * geometry.first_triangle;
  for (std::uint64_t quad = 0; quad < part.faces; quad++, at += 2 * floats_per_triangle) {
    const bool whole = same_vertex(at + 3, at + 15) && same_vertex(at + 6, at + 12);
    // What Embree drops is NaN in the file, and need not fit together.
    if (!whole && part.keeps(quad)) throw Doubt("two triangles of the file make no quad");
  }
}

Face FileFaces::face_of(std::uint32_t triangle) const noexcept {
  const std::uint32_t geometry = owners_[triangle];
  const Part& part = parts_[geometry];
  return {geometry, (triangle - part.first_triangle) / part.triangles_per_face()};
}

std::uint32_t FileFaces::triangle_of(Face face) const noexcept {
  const Part& part = parts_[face.geometry];
  return part.first_triangle + part.triangles_per_face() * face.number;
}

}  // namespace shim
