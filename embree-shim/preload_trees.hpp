// The trees that are to be planted, as embree-trace names them (exchange.h): the table, read at the first call of Embree, and a
// file's arrays, read when a scene has its geometries.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "exchange.h"
#include "faces.hpp"

namespace preload {

// What the geometries of a scene tell without a look at their vertices.
struct Count {
  std::uint32_t geometry;   // geomID
  std::uint32_t kind;       // as in ShimGeometry
  std::uint64_t triangles;  // not 0

  bool operator==(const Count& other) const noexcept {
    return geometry == other.geometry && kind == other.kind && triangles == other.triangles;
  }
  bool operator<(const Count& other) const noexcept { return geometry < other.geometry; }
};

class Trees {
 public:
  struct Known {
    ExchangeTree entry;
    std::vector<Count> counts;  // by geomID; empty when no scene can have them
    shim::Bounds box;           // of its root
  };

  explicit Trees(std::vector<Known> known, const ExchangeTrees& table) : known_(std::move(known)), table_(table) {}

  const std::vector<Known>& known() const noexcept { return known_; }
  // Adds to the list of what became of scenes.
  void report(ExchangeOutcome outcome) const noexcept;

 private:
  std::vector<Known> known_;
  ExchangeTrees table_;
};

// Null when nothing is to be planted.
const Trees* trees() noexcept;

// A file's arrays in memory of our own: what happens to the file later does not change them.
class TreeArrays {
 public:
  // Throws Doubt when the file is not the one that was meant, or cannot be read.
  explicit TreeArrays(const ExchangeTree& entry);

  // Borrows the arrays.
  ShimTreeFile file() const noexcept;

 private:
  std::vector<ShimNode> nodes_;
  std::vector<std::uint32_t> primitives_;
  std::vector<float> triangles_;
  std::vector<ShimGeometry> geometries_;
  std::vector<std::uint8_t> order_;
  std::uint32_t flags_;
};

}  // namespace preload
