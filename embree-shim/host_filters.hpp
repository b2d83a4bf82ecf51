// The filter functions of a recorded scene's geometries, wrapped while it is recorded.
#pragma once

#include <vector>

#include "host_faces.hpp"

namespace shim {

// Who watches what the filters of the calling thread's query do.
class FilterWatch {
 public:
  virtual ~FilterWatch() = default;
  // Has `filter` decide.
  virtual void see(const RTCFilterFunctionNArguments& arguments, RTCFilterFunctionN filter) = 0;
};

// Of the calling thread, while it asks a recorded scene; null otherwise, and then filters are not
// watched.
FilterWatch*& filter_watch() noexcept;

// One scene's.
class HostFilters {
 public:
  // Wraps them; nobody may be asking the scene. Throws Doubt when there are too many different
  // ones.
  HostFilters(const HostScene& scene, const HostNumbering& numbering);
  // Puts them back, those that the program has not replaced.
  ~HostFilters();
  HostFilters(const HostFilters&) = delete;
  HostFilters& operator=(const HostFilters&) = delete;

 private:
  void unwrap() noexcept;

  FilterPlaces places_{};
  std::vector<RTCGeometry> geometries_;  // retained
};

}  // namespace shim
