// Finds the real Embree: the next library in the search order, or, where the program loaded it privately (RTLD_LOCAL, as
// Python does with its modules), the one that the first caller was linked with, or else the one that is loaded, by its name. Wheels
// rename theirs: libembree4-4aef3270.so.4.
#include "preload_library.hpp"

#include <dlfcn.h>
#include <link.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <type_traits>
#include <utility>

#include "preload_exchange.hpp"
#include "preload_trees.hpp"

namespace preload {
namespace {

constexpr const char* three = "libembree3";
constexpr const char* four = "libembree4";

// Whether a path's last part starts with `start`.
bool is_named(const char* path, const char* start) noexcept {
  const char* slash = std::strrchr(path, '/');
  return std::strncmp(slash == nullptr ? path : slash + 1, start, std::strlen(start)) == 0;
}

// The path of a loaded library whose file's name starts with `start`; empty when there is none.
std::string loaded_path(const char* start) {
  std::pair<const char*, std::string> search{start, {}};
  dl_iterate_phdr(
      [](dl_phdr_info* info, std::size_t, void* into) {
        auto& [start, path] = *static_cast<decltype(search)*>(into);
        if (!is_named(info->dlpi_name, start)) return 0;
        path = info->dlpi_name;
        return 1;
      },
      &search);
  return search.second;
}

Version version_of(const void* function) noexcept {
  Dl_info info;
  if (dladdr(function, &info) == 0 || info.dli_fname == nullptr) return Version::other;
  const auto is = [&](const char* start) { return is_named(info.dli_fname, start); };
  return is(three) ? Version::three : is(four) ? Version::four : Version::other;
}

std::atomic<const void*> first_caller{nullptr};

// What the first caller was linked with, itself and below; null when that has no Embree.
void* linked_library() {
  Dl_info info;
  const void* caller = first_caller.load(std::memory_order_relaxed);
  if (caller == nullptr || dladdr(caller, &info) == 0 || info.dli_fname == nullptr) return nullptr;
  void* handle = dlopen(info.dli_fname, RTLD_NOLOAD | RTLD_NOW);
  if (handle == nullptr) return nullptr;
  const void* function = dlsym(handle, "rtcNewScene");
  // The program itself would lead back to this library.
  return function != nullptr && version_of(function) != Version::other ? handle : nullptr;
}

// A privately loaded Embree; null when there is none. Not closed again: what it holds is in use.
void* private_library() {
  if (void* linked = linked_library()) return linked;
  for (const char* start : {three, four}) {
    const std::string path = loaded_path(start);
    if (path.empty()) continue;
    if (void* handle = dlopen(path.c_str(), RTLD_NOLOAD | RTLD_NOW)) return handle;
  }
  return nullptr;
}

void* find(const char* name, bool needed) {
  if (void* next = dlsym(RTLD_NEXT, name)) return next;
  static void* const handle = private_library();
  if (handle != nullptr) {
    if (void* function = dlsym(handle, name)) return function;
  }
  if (needed) {
    std::fprintf(stderr, "embree-trace: error: %s is in no library that this program has loaded\n", name);
    std::abort();
  }
  return nullptr;
}

// Calls do not say which library they are meant for.
void warn_of_two(Version chosen) {
  if (loaded_path(three).empty() || loaded_path(four).empty()) return;
  std::fprintf(stderr,
               "embree-trace: warning: this program has loaded Embree 3 and Embree 4; all its calls go to Embree %d, and it may "
               "crash if it uses both\n",
               chosen == Version::four ? 4 : 3);
}

Library load() noexcept {
  Library library;
  library.version = version_of(find("rtcNewScene", true));
  const auto get = [](auto& function, const char* name, bool needed) {
    function = reinterpret_cast<std::remove_reference_t<decltype(function)>>(find(name, needed));
  };
  // Another version may lack what it was never asked for.
#define PRELOAD_FIND(name) get(library.name, #name, library.is_known());
  PRELOAD_FUNCTIONS(PRELOAD_FIND)
#undef PRELOAD_FIND
#define PRELOAD_FIND(name) get(library.name, #name, library.version == Version::three);
  PRELOAD_STREAMS(PRELOAD_FIND)
#undef PRELOAD_FIND
  get(library.rtcSetSharedGeometryBufferHostDevice, "rtcSetSharedGeometryBufferHostDevice", false);
  get(library.rtcSetNewGeometryBufferHostDevice, "rtcSetNewGeometryBufferHostDevice", false);
  warn_of_two(library.version);
  ExchangeHeader* header = exchange();
  if (header != nullptr && !library.is_known()) store(header->foreign, 1u);
  const Trees* planted = trees();
  if (planted != nullptr && !library.is_known()) {
    ExchangeOutcome outcome{};
    outcome.outcome = EXCHANGE_FOREIGN;
    planted->report(outcome);
  }
  return library;
}

}  // namespace

void called_from(const void* address) noexcept {
  const void* none = nullptr;
  first_caller.compare_exchange_strong(none, address, std::memory_order_relaxed);
}

const Library& real() noexcept {
  static const Library library = load();
  return library;
}

}  // namespace preload
