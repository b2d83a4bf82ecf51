// The file's side of planting: the faces that a `.bvh` says a scene has, as parts by geomID, and
// the checks of its tree. Whoever made the file is not believed.
#pragma once

#include <cstdint>
#include <vector>

#include "faces.hpp"
#include "shim.h"

namespace shim {

// A face: what a lane of a block holds.
struct Face {
  std::uint32_t geometry;
  std::uint32_t number;
};

// GEOM and TRIS as the parts of a scene. Vertices stay in the file's arrays, which must outlive it.
class FileFaces {
 public:
  // Throws Doubt when GEOM does not say, for each of the file's triangles, which face it is of.
  explicit FileFaces(const ShimTreeFile& file);

  const std::vector<Part>& parts() const noexcept { return parts_; }
  std::uint64_t triangle_count() const noexcept { return owners_.size(); }
  // Of a triangle that a geometry has; `owned` says whether one does.
  Face face_of(std::uint32_t triangle) const noexcept;
  bool owned(std::uint32_t triangle) const noexcept { return owners_[triangle] != none; }
  // The first of the face's triangles: a number for every face.
  std::uint32_t triangle_of(Face face) const noexcept;

 private:
  static constexpr std::uint32_t none = 0xFFFFFFFFu;

  void add(const ShimGeometry& geometry, const ShimTreeFile& file);
  void add_quads(const ShimGeometry& geometry, const ShimTreeFile& file);

  std::vector<Part> parts_;
  std::vector<std::uint32_t> owners_;  // geomID by triangle
  std::vector<std::vector<std::uint32_t>> fours_;  // corners of quads, by geometry that has them
};

// Checks structure, boxes and leaves: that the tree is one, that boxes are finite and hold what is
// below them, and that every face that Embree keeps, and no other, stands in one leaf, or, with
// spatial splits, in leaves whose boxes together cover it. Throws Doubt at the first that fails.
void check_file_tree(const ShimTreeFile& file, const FileFaces& faces);

}  // namespace shim
