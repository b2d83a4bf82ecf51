// A triangle minus the boxes of its leaves is nothing: each box cuts what is left of the triangle
// into pieces outside of it, at most one a plane, until no piece is left or no box.
#include "plant_cover.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "memory.hpp"

namespace shim {
namespace {

// A convex polygon: a triangle has three corners, and each of the six planes of a box, of which
// pieces of pieces may be cut by many, adds at most one.
using Point = std::array<double, 3>;
using Polygon = std::vector<Point>;

// The part of the polygon on one side of a plane across `axis`: where `sign` * x <= `sign` * `at`.
void cut(const Polygon& polygon, int axis, double at, double sign, Polygon& out) {
  out.clear();
  for (std::size_t corner = 0; corner < polygon.size(); corner++) {
    const Point& from = polygon[corner];
    const Point& to = polygon[(corner + 1) % polygon.size()];
    const double before = sign * (from[axis] - at);
    const double after = sign * (to[axis] - at);
    if (before <= 0) out.push_back(from);
    if ((before < 0 && after > 0) || (before > 0 && after < 0)) {
      const double share = before / (before - after);
      Point between;
      for (int other = 0; other < 3; other++) {
        between[other] = from[other] + share * (to[other] - from[other]);
      }
      between[axis] = at;
      out.push_back(between);
    }
  }
}

// How far the polygon reaches beyond a plane.
double beyond(const Polygon& polygon, int axis, double at, double sign) noexcept {
  double most = -std::numeric_limits<double>::infinity();
  for (const Point& corner : polygon) most = std::max(most, sign * (corner[axis] - at));
  return most;
}

class Cover {
 public:
  // Whether the boxes cover the triangle.
  bool covers(const Polygon& triangle, const ClippedTriangle* first, const ClippedTriangle* last) {
    double largest = 0;
    for (const Point& corner : triangle) {
      for (const double coordinate : corner) largest = std::max(largest, std::fabs(coordinate));
    }
    slack_ = 8 * static_cast<double>(std::numeric_limits<float>::epsilon()) * largest;
    left_.assign(1, triangle);
    for (; first != last && !left_.empty(); first++) {
      next_.clear();
      for (const Polygon& piece : left_) subtract(piece, first->box);
      left_.swap(next_);
    }
    return left_.empty();
  }

 private:
  // Adds what of the piece is outside of the box to the next pieces.
  void subtract(const Polygon& piece, const Bounds& box) {
    // A hostile file may cut one triangle into very many leaves that each cut all that is left.
    constexpr std::uint64_t most_work = 200'000'000;
    if (++work_ > most_work) throw Doubt("the file's spatial splits are too many to be checked");
    for (int axis = 0; axis < 3; axis++) {
      const double away_below = -beyond(piece, axis, box.lower[axis] - slack_, 1);
      const double away_above = -beyond(piece, axis, box.upper[axis] + slack_, -1);
      if (away_below >= 0 || away_above >= 0) {
        next_.push_back(piece);
        return;
      }
    }
    inside_ = piece;
    for (int axis = 0; axis < 3; axis++) {
      take_away(axis, box.upper[axis] + slack_, 1);
      take_away(axis, box.lower[axis] - slack_, -1);
    }
  }

  // Parts what is inside so far at a plane. A part beyond it that is thinner than rounding is none.
  void take_away(int axis, double at, double sign) {
    if (beyond(inside_, axis, at, sign) <= slack_ / 2) return;
    Polygon outside;
    cut(inside_, axis, at, -sign, outside);
    next_.push_back(std::move(outside));
    cut(inside_, axis, at, sign, kept_);
    inside_.swap(kept_);
  }

  double slack_ = 0;
  std::uint64_t work_ = 0;
  std::vector<Polygon> left_;
  std::vector<Polygon> next_;
  Polygon inside_;
  Polygon kept_;
};

Polygon polygon_of(std::uint32_t triangle, const FileFaces& faces) {
  const Face face = faces.face_of(triangle);
  const Part& part = faces.parts()[face.geometry];
  Polygon polygon;
  for (const std::uint32_t corner : part.corners_of(triangle - faces.triangle_of(face))) {
    const auto position = part.vertex(face.number, corner);
    polygon.push_back({position[0], position[1], position[2]});
  }
  return polygon;
}

}  // namespace

void check_covered(std::vector<ClippedTriangle> parts, const FileFaces& faces) {
  const auto by_triangle = [](const ClippedTriangle& a, const ClippedTriangle& b) {
    return a.triangle < b.triangle;
  };
  std::stable_sort(parts.begin(), parts.end(), by_triangle);
  Cover cover;
  for (auto first = parts.begin(); first != parts.end();) {
    const auto last = std::upper_bound(first, parts.end(), *first, by_triangle);
    const Polygon triangle = polygon_of(first->triangle, faces);
    if (!cover.covers(triangle, &*first, &*first + (last - first))) {
      throw Doubt("the leaves of a split triangle of the file's tree do not cover it");
    }
    first = last;
  }
}

}  // namespace shim
