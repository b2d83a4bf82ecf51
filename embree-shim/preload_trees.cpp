// Reads the table and the files with read(2): a mapping of a file that shrinks would end the program.
#include "preload_trees.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <utility>

#include "memory.hpp"

namespace preload {
namespace {

constexpr const char* variable = "EMBREE_TRACE_TREES";
constexpr std::size_t floats_per_triangle = 9;
constexpr std::uint32_t no_instance = 0xFFFFFFFFu;

// A file that is open for reading.
class Input {
 public:
  explicit Input(const char* path) noexcept : file_(open(path, O_RDONLY | O_CLOEXEC)) {
    if (file_ < 0 || fstat(file_, &status_) != 0) status_ = {};
  }
  ~Input() {
    if (file_ >= 0) close(file_);
  }
  Input(const Input&) = delete;
  Input& operator=(const Input&) = delete;

  std::uint64_t bytes() const noexcept { return static_cast<std::uint64_t>(status_.st_size); }
  std::uint64_t inode() const noexcept { return status_.st_ino; }

  // `count` elements from the byte `offset` on; throws Doubt when the file has not so many.
  template <typename T>
  std::vector<T> read(std::uint64_t offset, std::uint64_t count) const {
    if (offset > bytes() || count > (bytes() - offset) / sizeof(T)) throw shim::Doubt("its file is shorter than it was");
    std::vector<T> elements(count);
    auto* into = reinterpret_cast<char*>(elements.data());
    std::size_t left = count * sizeof(T);
    while (left != 0) {
      const ssize_t got = pread(file_, into, left, static_cast<off_t>(offset));
      if (got < 0 && errno == EINTR) continue;
      if (got <= 0) throw shim::Doubt("its file cannot be read");
      into += got;
      offset += static_cast<std::uint64_t>(got);
      left -= static_cast<std::size_t>(got);
    }
    return elements;
  }

 private:
  int file_;
  struct stat status_ {};
};

// Throws Doubt when the path leads to another file by now.
void check_same(const Input& input, const ExchangeTree& entry) {
  if (input.bytes() != entry.bytes || input.inode() != entry.inode) {
    throw shim::Doubt("its file has been replaced or removed since the program was started");
  }
}

// What is looked at before the arrays are: the rows of GEOM that have triangles, and the box of the root. Instances and what moves
// are in no scene as the file has them.
Trees::Known known_of(const ExchangeTree& entry) {
  Trees::Known known{entry, {}, {}};
  const Input input(entry.path);
  check_same(input, entry);
  if (entry.node_count == 0) return known;
  const ShimNode root = input.read<ShimNode>(entry.nodes, 1).front();
  std::copy(root.lower, root.lower + 3, known.box.lower);
  std::copy(root.upper, root.upper + 3, known.box.upper);
  std::vector<Count> counts;
  for (const ShimGeometry& row : input.read<ShimGeometry>(entry.geometries, entry.geometry_count)) {
    if (row.instance != no_instance) return known;
    if (row.triangle_count != 0) counts.push_back({row.geometry, row.kind, row.triangle_count});
  }
  std::sort(counts.begin(), counts.end());
  known.counts.swap(counts);
  return known;
}

const Trees* read_table() noexcept {
  const char* path = std::getenv(variable);
  if (path == nullptr) return nullptr;
  const int saved = errno;
  const Trees* found = nullptr;
  try {
    const Input input(path);
    const ExchangeTrees table = input.read<ExchangeTrees>(0, 1).front();
    if (table.magic != EXCHANGE_MAGIC) throw shim::Doubt("it is of another version of embree-trace");
    std::vector<Trees::Known> known;
    for (const ExchangeTree& entry : input.read<ExchangeTree>(sizeof table, table.count)) {
      try {
        known.push_back(known_of(entry));
      } catch (const shim::Doubt&) {
        // It is in no scene then, and embree-trace says so at the end.
        known.push_back({entry, {}, {}});
      }
    }
    found = new Trees(std::move(known), table);
  } catch (const std::exception& problem) {
    std::fprintf(stderr, "embree-trace: warning: %s does not lead to trees, and none is planted: %s\n", variable, problem.what());
  }
  errno = saved;
  return found;
}

}  // namespace

const Trees* trees() noexcept {
  // Never freed: the program may use Embree until its last moment.
  static const Trees* const trees = read_table();
  return trees;
}

void Trees::report(ExchangeOutcome outcome) const noexcept {
  outcome.process = static_cast<std::uint32_t>(getpid());
  const int file = open(table_.outcomes, O_WRONLY | O_APPEND | O_CLOEXEC);
  if (file < 0) return;
  // Without embree-trace, which has ended then, nobody would read it.
  if (write(file, &outcome, sizeof outcome) < 0) errno = 0;
  close(file);
}

TreeArrays::TreeArrays(const ExchangeTree& entry) : flags_(entry.flags) {
  const Input input(entry.path);
  check_same(input, entry);
  if (entry.triangle_count > entry.bytes) throw shim::Doubt("its file is shorter than it was");
  nodes_ = input.read<ShimNode>(entry.nodes, entry.node_count);
  primitives_ = input.read<std::uint32_t>(entry.primitives, entry.primitive_count);
  triangles_ = input.read<float>(entry.triangles, floats_per_triangle * entry.triangle_count);
  geometries_ = input.read<ShimGeometry>(entry.geometries, entry.geometry_count);
  if (entry.order != 0) order_ = input.read<std::uint8_t>(entry.order, entry.node_count);
}

ShimTreeFile TreeArrays::file() const noexcept {
  ShimTreeFile file{};
  file.nodes = nodes_.data();
  file.node_count = nodes_.size();
  file.primitives = primitives_.data();
  file.primitive_count = primitives_.size();
  file.triangles = triangles_.data();
  file.triangle_count = triangles_.size() / floats_per_triangle;
  file.geometries = geometries_.data();
  file.geometry_count = geometries_.size();
  file.order = order_.empty() ? nullptr : order_.data();
  file.flags = flags_;
  return file;
}

}  // namespace preload
