#include "sensor-hal/plugin/plugin_file.h"

#include <dlfcn.h>
#include <elf.h>

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <fstream>
#include <optional>
#include <vector>

#include "sensor-hal/plugin/plugin_abi.h"

namespace rigor {
namespace {

#if defined(__x86_64__)
constexpr Elf64_Half kMachine = EM_X86_64;
#elif defined(__aarch64__)
constexpr Elf64_Half kMachine = EM_AARCH64;
#else
#error "plugins: name this machine's ELF number"
#endif

/// Where the entry's texts lie, and which lies where, is for ever.
using AnyEntry = PluginEntry<int>;
static_assert(offsetof(AnyEntry, magic) == 0 && offsetof(AnyEntry, abi) == 32 &&
              offsetof(AnyEntry, name) == 512);
constexpr std::size_t kTexts = offsetof(AnyEntry, name);

class ElfFile {
 public:
  explicit ElfFile(std::string bytes) : bytes_(std::move(bytes)) {}

  /// A T at an offset; empty where the file ends before.
  template <class T>
  [[nodiscard]] std::optional<T> read(std::uint64_t at) const {
    T out;
    if (at > bytes_.size() || bytes_.size() - at < sizeof out) return std::nullopt;
    std::memcpy(&out, bytes_.data() + at, sizeof out);
    return out;
  }
  template <class T>
  [[nodiscard]] std::optional<T> item(std::uint64_t table, std::uint64_t index) const {
    if (index > bytes_.size() || table > bytes_.size()) return std::nullopt;
    return read<T>(table + index * sizeof(T));
  }
  [[nodiscard]] std::string text(std::uint64_t at) const {
    if (at >= bytes_.size()) return "";
    return bytes_.substr(at, bytes_.find('\0', at) - at);
  }
  [[nodiscard]] std::string bytes(std::uint64_t at, std::size_t count) const {
    return at <= bytes_.size() && bytes_.size() - at >= count ? bytes_.substr(at, count) : "";
  }

  [[nodiscard]] bool is_shared_object() const {
    const auto h = read<Elf64_Ehdr>(0);
    return h && std::memcmp(h->e_ident, ELFMAG, SELFMAG) == 0 && h->e_ident[EI_CLASS] == ELFCLASS64 &&
           h->e_ident[EI_DATA] == ELFDATA2LSB && h->e_type == ET_DYN && h->e_machine == kMachine;
  }
  /// Every header and section that the file promises lies in it.
  [[nodiscard]] bool is_whole() const {
    const auto h = read<Elf64_Ehdr>(0);
    for (std::uint64_t i = 0; i < h->e_phnum; ++i) {
      const auto p = item<Elf64_Phdr>(h->e_phoff, i);
      if (!p || p->p_offset > bytes_.size() || bytes_.size() - p->p_offset < p->p_filesz) return false;
    }
    return h->e_shnum == 0 || item<Elf64_Shdr>(h->e_shoff, h->e_shnum - 1U).has_value();
  }
  /// Offset of the object of this name that the file exports, and its size.
  struct Found {
    std::uint64_t offset = 0, size = 0;
  };
  [[nodiscard]] std::optional<Found> find_object(std::string_view name) const {
    const auto h = read<Elf64_Ehdr>(0);
    for (std::uint64_t i = 0; i < h->e_shnum; ++i) {
      const auto symbols = item<Elf64_Shdr>(h->e_shoff, i);
      if (!symbols || symbols->sh_type != SHT_DYNSYM) continue;
      const auto names = item<Elf64_Shdr>(h->e_shoff, symbols->sh_link);
      if (!names) return std::nullopt;
      for (std::uint64_t k = 0; k < symbols->sh_size / sizeof(Elf64_Sym); ++k) {
        const auto s = item<Elf64_Sym>(symbols->sh_offset, k);
        if (!s) return std::nullopt;
        if (s->st_shndx == SHN_UNDEF || ELF64_ST_TYPE(s->st_info) != STT_OBJECT) continue;
        if (s->st_name > bytes_.size() || text(names->sh_offset + s->st_name) != name) continue;
        const auto offset = file_offset(s->st_value, s->st_size);
        if (!offset) return std::nullopt;
        return Found{*offset, s->st_size};
      }
    }
    return std::nullopt;
  }

 private:
  [[nodiscard]] std::optional<std::uint64_t> file_offset(std::uint64_t address, std::uint64_t size) const {
    const auto h = read<Elf64_Ehdr>(0);
    for (std::uint64_t i = 0; i < h->e_phnum; ++i) {
      const auto p = item<Elf64_Phdr>(h->e_phoff, i);
      if (!p || p->p_type != PT_LOAD || address < p->p_vaddr) continue;
      const auto within = address - p->p_vaddr;
      if (within <= p->p_filesz && p->p_filesz - within >= size) return p->p_offset + within;
    }
    return std::nullopt;
  }
  std::string bytes_;
};

std::vector<std::string> items(const std::string& abi) {
  std::vector<std::string> out(1);
  for (std::size_t i = 0; i < abi.size(); ++i) {
    if (abi.compare(i, 2, "; ") == 0) {
      out.emplace_back();
      ++i;
    } else {
      out.back() += abi[i];
    }
  }
  return out;
}

}  // namespace

Result<std::string> plugin_abi_of(const std::filesystem::path& file, const PluginKind& kind) {
  using std::string;
  const string entry = kind.entry, noun = kind.noun;
  const auto refuse = [&](std::string message) {
    return fail(ErrorCode::bad_input, file.string(), std::move(message));
  };
  std::error_code ec;
  const auto status = std::filesystem::status(file, ec);
  if (status.type() == std::filesystem::file_type::not_found)
    return fail(ErrorCode::not_found, file.string(), "expected a plugin, got nothing: no such file");
  if (!std::filesystem::is_regular_file(status))
    return refuse("expected a plugin, got something that is no file; name the shared object itself");
  std::ifstream in(file, std::ios::binary);
  std::string bytes((std::istreambuf_iterator<char>(in)), {});
  if (!in) return refuse("expected a plugin, got a file that cannot be read; check its rights");
  const ElfFile elf(std::move(bytes));
  if (!elf.is_shared_object())
    return refuse(
        "expected a shared object for this machine, got another file; build the plugin with "
        "add_library(… MODULE …)");
  if (!elf.is_whole())
    return refuse("expected a shared object, got one that is cut short; copy or build it again");
  const auto found = elf.find_object(entry);
  if (!found)
    return refuse("expected a " + noun + ", got a shared object without the entry " + entry + "; put " +
                  kind.macro + "(…) into one of its sources");
  const auto texts = found->size >= kTexts ? elf.bytes(found->offset, kTexts) : "";
  if (texts.size() != kTexts || string(texts.c_str()) != kind.magic)
    return refuse("expected a " + noun + ", got an entry " + entry + " of another form; use the macro " +
                  kind.macro);
  const auto abi = texts.substr(offsetof(AnyEntry, abi));
  return abi.substr(0, abi.find('\0'));
}

Result<const void*> open_plugin(const std::filesystem::path& file, const PluginKind& kind,
                                const std::string& library_abi) {
  const auto abi = plugin_abi_of(file, kind);
  if (!abi) return tl::unexpected<Error>(abi.error());
  if (const auto difference = abi_difference(library_abi, *abi); !difference.empty())
    return fail(ErrorCode::bad_input, file.string(),
                difference + "; build the plugin again, with this Rigor's headers and compiler");
  // Absolute: without a slash dlopen would look for the name elsewhere.
  std::error_code ec;
  const auto path = std::filesystem::absolute(file, ec);
  void* object = dlopen(path.c_str(), RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE);
  if (object == nullptr) {
    const char* why = dlerror();
    return fail(ErrorCode::bad_input, file.string(),
                std::string("expected a plugin that can be loaded, got: ") +
                    (why ? why : "an unknown error") + "; link it with " + kind.target);
  }
  const auto* entry = static_cast<const AnyEntry*>(dlsym(object, kind.entry));
  if (entry != nullptr && library_abi != entry->abi)
    return fail(ErrorCode::bad_input, file.string(),
                "expected the plugin as it lies on the disk, got an older one that this process has loaded; "
                "start the process anew");
  if (entry == nullptr)
    return fail(ErrorCode::bad_input, file.string(),
                std::string("expected the entry ") + kind.entry + ", found none in what was loaded");
  return entry;
}

std::string abi_difference(const std::string& library, const std::string& plugin) {
  const auto ours = items(library), theirs = items(plugin);
  std::string out;
  for (std::size_t i = 0; i < std::max(ours.size(), theirs.size()); ++i) {
    const std::string a = i < ours.size() ? ours[i] : "nothing",
                      b = i < theirs.size() ? theirs[i] : "nothing";
    if (a != b) out += (out.empty() ? "expected " : "; expected ") + a + ", got " + b;
  }
  return out;
}

}  // namespace rigor
