// The seam that recording stands on: whoever answers queries is an Intersector, and a decorator is one too.
#pragma once

#include <cstdint>

#include "shim.h"

namespace shim {

using Query = ShimQuery;
using Hit = ShimHit;

enum class Outcome : std::uint32_t { miss = SHIM_MISS, hit = SHIM_HIT, refused = SHIM_REFUSED };

// Lanes of a packet.
enum class Width : std::uint32_t { four = 4, eight = 8, sixteen = 16 };

// Answers queries; for one thread at a time. Nothing in here allocates, locks or throws.
class Intersector {
 public:
  Intersector() = default;
  Intersector(const Intersector&) = delete;
  Intersector& operator=(const Intersector&) = delete;
  virtual ~Intersector() = default;

  // The nearest hit within [tnear, tfar]; fills `hit` when it returns Outcome::hit, and leaves it alone otherwise.
  virtual Outcome closest_hit(const Query& query, Hit& hit) noexcept = 0;
  // Whether anything lies within [tnear, tfar].
  virtual Outcome occluded(const Query& query) noexcept = 0;
  // The same for a packet. On triangles the answers are those of the single queries bit for bit; on quads Embree's packet
  // kernels differ from its single ones in the last bits of u and v.
  virtual void closest_hits(const Query* queries, Width width, Hit* hits, Outcome* outcomes) noexcept = 0;
  virtual void occluded_packet(const Query* queries, Width width, Outcome* outcomes) noexcept = 0;

  // Hands on whatever is held back; false once whoever receives it wants no more.
  virtual bool flush() noexcept { return true; }
  // Queries that were refused so far (see ray_check.hpp).
  virtual std::uint64_t refused() const noexcept = 0;
};

}  // namespace shim
