// The live blocks against the file: whether every lane is the face that the file says, with the
// same vertices; and what of a lane has to be taken over.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "live_bvh.hpp"
#include "plant_file.hpp"

namespace shim {

// Where the vertices of one of the scene's geometries are (rtcGetGeometryBufferData); null when
// there are none.
using VertexData = const void* (*)(const void* scene, std::uint32_t geometry);

// Compares each lane that the live reader sees. Blocks of words (triangle4i, quad4i) hold no
// vertices, but how many words behind the geometry's first one they lie; those are kept.
class LaneCheck final : public LaneSink {
 public:
  LaneCheck(const FileFaces& faces, const void* scene, VertexData vertices)
      : faces_(faces), scene_(scene), vertices_(vertices) {}

  void see(const LiveBvh& bvh, const unsigned char* block, std::size_t lane, std::uint32_t geometry,
           std::uint32_t face, Memory& memory) override;

  // The words of a face, which a block of words must have.
  const std::array<std::uint32_t, 4>& words_of(Face face) const noexcept {
    return words_[faces_.triangle_of(face)];
  }

 private:
  void see_words(const Part& part, const unsigned char* block, std::size_t lane, Face face,
                 Memory& memory);
  std::uintptr_t first_vertex(std::uint32_t geometry);

  const FileFaces& faces_;
  const void* scene_;
  VertexData vertices_;
  std::vector<std::array<std::uint32_t, 4>> words_;  // by the face's first triangle
  std::vector<std::uintptr_t> first_vertices_;       // by geometry; 0: not asked for yet
};

}  // namespace shim
