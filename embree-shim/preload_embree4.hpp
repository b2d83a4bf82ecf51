// The calls of Embree 4 that ask, as they arrive at those of Embree 3: with the ray where Embree 3 has the context, and the
// arguments, which may be null, where it has the ray. An unknown version's are passed on as they are.
#pragma once

#include "preload_call.hpp"

namespace embree4 {

inline bool is_coherent(const Arguments* arguments) noexcept {
  return arguments != nullptr && (arguments->flags & coherent) != 0;
}

inline RTCFilterFunctionN* filter_of(Arguments* arguments) noexcept {
  return arguments == nullptr ? nullptr : &arguments->filter;
}

template <bool closest, typename Function>
void single(Function function, RTCScene scene, void* ray, void* last) noexcept {
  const auto ask = reinterpret_cast<Single>(function);
  auto* arguments = static_cast<Arguments*>(last);
  if (!preload::real().is_known()) return ask(scene, ray, arguments);
  preload::Call call(scene, is_coherent(arguments), filter_of(arguments));
  preload::single<closest>(call, ray, [=] { ask(scene, ray, arguments); });
}

template <unsigned width, bool closest, typename Function>
void packet(Function function, const int* valid, RTCScene scene, void* rays, void* last) noexcept {
  const auto ask = reinterpret_cast<Packet>(function);
  auto* arguments = static_cast<Arguments*>(last);
  if (!preload::real().is_known()) return ask(valid, scene, rays, arguments);
  preload::Call call(scene, is_coherent(arguments), filter_of(arguments));
  preload::packet<width, closest>(call, valid, rays, [=] { ask(valid, scene, rays, arguments); });
}

}  // namespace embree4
