// Live blocks against the file's vertices, bit for bit.
#include "plant_lanes.hpp"

#include <cstring>

#include "plant_blocks.hpp"

namespace shim {

void LaneCheck::see(const LiveBvh& bvh, const unsigned char* block, std::size_t lane,
                    std::uint32_t geometry, std::uint32_t number, Memory& memory) {
  const Part& part = faces_.parts()[geometry];
  const Face face{geometry, number};
  const layout::Contents contents = bvh.block->contents;
  if (contents == layout::Contents::words) {
    see_words(part, block, lane, face, memory);
    return;
  }
  const LaneFloats expected = lane_floats(part, number, contents);
  for (std::size_t row = 0; row < 3 * part.corners; row++) {
    const unsigned char* at = block + (row * layout::block_lanes + lane) * sizeof(float);
    if (std::memcmp(at, &expected[row], sizeof(float)) != 0) {
      throw Doubt("the scene's triangles are not those of the file");
    }
  }
}

void LaneCheck::see_words(const Part& part, const unsigned char* block, std::size_t lane, Face face,
                          Memory& memory) {
  if (words_.empty()) words_.resize(faces_.triangle_count());
  std::array<std::uint32_t, 4>& words = words_[faces_.triangle_of(face)];
  const std::uintptr_t first = first_vertex(face.geometry);
  for (std::uint32_t corner = 0; corner < part.corners; corner++) {
    const unsigned char* at = block + (corner * layout::block_lanes + lane) * sizeof(std::uint32_t);
    std::memcpy(&words[corner], at, sizeof(std::uint32_t));
    std::array<float, 3> position;
    const std::uintptr_t vertex = first + sizeof(float) * std::uint64_t{words[corner]};
    memory.read(Object::vertex, vertex, position.data(), sizeof position);
    const auto expected = part.vertex(face.number, corner);
    if (std::memcmp(position.data(), expected.data(), sizeof position) != 0) {
      throw Doubt("the scene's triangles are not those of the file");
    }
  }
}

std::uintptr_t LaneCheck::first_vertex(std::uint32_t geometry) {
  if (first_vertices_.empty()) first_vertices_.resize(faces_.parts().size());
  std::uintptr_t& first = first_vertices_[geometry];
  if (first == 0) {
    first = reinterpret_cast<std::uintptr_t>(vertices_(scene_, geometry));
    if (first == 0) throw Doubt("a geometry of the scene has no vertices");
  }
  return first;
}

}  // namespace shim
