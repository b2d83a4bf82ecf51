// A recorded scene's geometries -> their filter functions, each in a wrapper.
#include "host_filters.hpp"

#include <memory>
#include <mutex>
#include <unordered_map>

#include "filter_wrappers.hpp"

namespace shim {
namespace {

void watch(const RTCFilterFunctionNArguments& arguments, RTCFilterFunctionN filter) {
  FilterWatch* watch = filter_watch();
  watch == nullptr ? filter(&arguments) : watch->see(arguments, filter);
}

using Wrappers = FilterWrappers<RTCFilterFunctionNArguments, &watch>;

RTCFilterFunctionN wrapped(RTCFilterFunctionN filter) {
  if (const RTCFilterFunctionN wrapper = Wrappers::wrapped(filter)) return wrapper;
  throw Doubt("the program has more than 128 filter functions");
}

// How many recordings have a geometry's filters wrapped: scenes may share it.
std::mutex uses_lock;
std::unordered_map<RTCGeometry, unsigned> uses;

RTCFilterFunctionN filter_at(RTCGeometry geometry, std::size_t place) noexcept {
  const auto* at =
      reinterpret_cast<const RTCFilterFunctionN*>(reinterpret_cast<const char*>(geometry) + place);
  return *at;
}

}  // namespace

FilterWatch*& filter_watch() noexcept {
  static thread_local FilterWatch* watch = nullptr;
  return watch;
}

HostFilters::HostFilters(const HostScene& scene, const HostNumbering& numbering) {
  const std::vector<std::uint32_t> numbers = numbering.geometries();
  if (numbers.empty()) return;
  RTCDevice device = rtcGetSceneDevice(scene.get());
  const std::unique_ptr<RTCDeviceTy, decltype(&rtcReleaseDevice)> held(device, &rtcReleaseDevice);
  places_ = find_filters(device);
  geometries_.reserve(numbers.size());
  try {
    for (const std::uint32_t number : numbers) {
      RTCGeometry geometry = rtcGetGeometry(scene.get(), number);
      const RTCFilterFunctionN intersect = filter_at(geometry, places_.intersect);
      const RTCFilterFunctionN occluded = filter_at(geometry, places_.occluded);
      if (intersect == nullptr && occluded == nullptr) continue;
      const RTCFilterFunctionN ours = intersect == nullptr ? nullptr : wrapped(intersect);
      const RTCFilterFunctionN ours_too = occluded == nullptr ? nullptr : wrapped(occluded);
      const std::lock_guard<std::mutex> lock(uses_lock);
      uses[geometry]++;
      rtcRetainGeometry(geometry);
      geometries_.push_back(geometry);
      if (ours != nullptr) rtcSetGeometryIntersectFilterFunction(geometry, ours);
      if (ours_too != nullptr) rtcSetGeometryOccludedFilterFunction(geometry, ours_too);
    }
  } catch (...) {
    unwrap();
    throw;
  }
}

HostFilters::~HostFilters() { unwrap(); }

void HostFilters::unwrap() noexcept {
  const std::lock_guard<std::mutex> lock(uses_lock);
  for (RTCGeometry geometry : geometries_) {
    const auto found = uses.find(geometry);
    if (--found->second == 0) {
      uses.erase(found);
      if (const auto filter = Wrappers::unwrapped(filter_at(geometry, places_.intersect))) {
        rtcSetGeometryIntersectFilterFunction(geometry, filter);
      }
      if (const auto filter = Wrappers::unwrapped(filter_at(geometry, places_.occluded))) {
        rtcSetGeometryOccludedFilterFunction(geometry, filter);
      }
    }
    rtcReleaseGeometry(geometry);
  }
  geometries_.clear();
}

}  // namespace shim
