// The program's filter functions -> wrappers that note what they reject while a recorded call is under way.
#include "preload_filters.hpp"

#include "asking_filters.hpp"
#include "filter_wrappers.hpp"
#include "preload_thread.hpp"

namespace preload {
namespace {

void watch(const RTCFilterFunctionNArguments& arguments, RTCFilterFunctionN filter) {
  Thread* thread = this_thread();
  Frame* frame = thread == nullptr ? nullptr : thread->frame;
  if (frame == nullptr || frame->capture == nullptr) return filter(&arguments);
  const std::uint64_t lost = shim::asking::watch(*frame, *frame->capture, arguments, filter);
  if (lost == 0) return;
  if (ExchangeHeader* header = exchange()) add(header->lost_rejects, lost);
}

using Wrappers = shim::FilterWrappers<RTCFilterFunctionNArguments, &watch>;

}  // namespace

RTCFilterFunctionN wrapped(RTCFilterFunctionN filter) noexcept {
  if (filter == nullptr || exchange() == nullptr || !real().is_known()) return filter;
  if (const RTCFilterFunctionN wrapper = Wrappers::wrapped(filter)) return wrapper;
  fail("the program has more than 128 filter functions");
  return filter;
}

}  // namespace preload

void rtcSetGeometryIntersectFilterFunction(RTCGeometry geometry, RTCFilterFunctionN filter) {
  preload::real().rtcSetGeometryIntersectFilterFunction(geometry, preload::wrapped(filter));
}

void rtcSetGeometryOccludedFilterFunction(RTCGeometry geometry, RTCFilterFunctionN filter) {
  preload::real().rtcSetGeometryOccludedFilterFunction(geometry, preload::wrapped(filter));
}
