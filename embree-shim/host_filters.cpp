// Embree passes a filter nothing that would lead to the wrapped one, so each function of the
// program gets a wrapper of its own out of a fixed number; programs have few.
#include "host_filters.hpp"

#include <algorithm>
#include <array>
#include <atomic>
#include <mutex>
#include <unordered_map>
#include <utility>

namespace shim {
namespace {

constexpr std::size_t most_filters = 128;
std::atomic<RTCFilterFunctionN> filters[most_filters];

template <std::size_t number>
void wrapper(const RTCFilterFunctionNArguments* arguments) {
  const RTCFilterFunctionN filter = filters[number].load(std::memory_order_relaxed);
  FilterWatch* watch = filter_watch();
  watch == nullptr ? filter(arguments) : watch->see(*arguments, filter);
}

template <std::size_t... numbers>
constexpr std::array<RTCFilterFunctionN, most_filters> make_wrappers(
    std::index_sequence<numbers...>) {
  return {&wrapper<numbers>...};
}
constexpr auto wrappers = make_wrappers(std::make_index_sequence<most_filters>());

RTCFilterFunctionN wrapped(RTCFilterFunctionN filter) {
  for (std::size_t number = 0; number < most_filters; number++) {
    if (wrappers[number] == filter) return filter;
    RTCFilterFunctionN there = filters[number].load(std::memory_order_acquire);
    if (there == nullptr && filters[number].compare_exchange_strong(there, filter)) there = filter;
    if (there == filter) return wrappers[number];
  }
  throw Doubt("the program has more than 128 filter functions");
}

// What a wrapper wraps; null for what is none.
RTCFilterFunctionN unwrapped(RTCFilterFunctionN filter) noexcept {
  for (std::size_t number = 0; number < most_filters; number++) {
    if (wrappers[number] == filter) return filters[number].load(std::memory_order_acquire);
  }
  return nullptr;
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
      if (const auto filter = unwrapped(filter_at(geometry, places_.intersect))) {
        rtcSetGeometryIntersectFilterFunction(geometry, filter);
      }
      if (const auto filter = unwrapped(filter_at(geometry, places_.occluded))) {
        rtcSetGeometryOccludedFilterFunction(geometry, filter);
      }
    }
    rtcReleaseGeometry(geometry);
  }
  geometries_.clear();
}

}  // namespace shim
