//! Builds the shim (`embree-shim/`, C++) and its Rust declarations; nothing without the feature `embree`.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    #[cfg(feature = "embree")]
    if let Err(problem) = embree::build() {
        println!("cargo::error={problem}");
        std::process::exit(1);
    }
}

#[cfg(feature = "embree")]
mod embree {
    use std::path::{Path, PathBuf};

    /// What to do when a package is missing; every such error ends with it.
    const INSTALL: &str =
        "install it with `sudo apt-get install libembree-dev libclang-dev g++`, or run `./tools/setup`";
    const DIRECTORY: &str = "embree-shim";

    /// Checks that the packages are there, compiles the shim, binds its C ABI.
    pub fn build() -> Result<(), String> {
        println!("cargo::rerun-if-changed={DIRECTORY}");
        let sources = sources()?;
        let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or("OUT_DIR is not set")?);
        let mut shim = cc::Build::new();
        // Optimised in the dev profile too: it stands between every query and Embree.
        shim.cpp(true)
            .std("c++17")
            .opt_level(2)
            .warnings(true)
            .extra_warnings(true)
            .warnings_into_errors(true);
        shim.files(&sources);
        check_packages(&shim, &out)?;
        shim.try_compile("embree_trace_shim")
            .map_err(|error| format!("cannot compile {DIRECTORY}: {error}"))?;
        println!("cargo::rustc-link-lib=embree3");
        bind(&out)
    }

    /// The C++ files, in a fixed order.
    fn sources() -> Result<Vec<PathBuf>, String> {
        let entries =
            std::fs::read_dir(DIRECTORY).map_err(|error| format!("cannot read {DIRECTORY}: {error}"))?;
        let mut sources: Vec<PathBuf> = entries
            .filter_map(|entry| entry.ok().map(|entry| entry.path()))
            .filter(|path| path.extension().is_some_and(|extension| extension == "cpp"))
            .collect();
        sources.sort();
        Ok(sources)
    }

    /// A compiler, Embree's header and Embree's library, each asked for by name: the errors of a failed build would not say
    /// which package is missing.
    fn check_packages(shim: &cc::Build, out: &Path) -> Result<(), String> {
        let compiler = shim
            .try_get_compiler()
            .map_err(|error| format!("there is no C++ compiler ({error}): {INSTALL}"))?;
        let run = |arguments: &[&str]| {
            compiler.to_command().args(arguments).current_dir(out).output().map_err(|error| {
                format!("cannot run the C++ compiler {}: {error}: {INSTALL}", compiler.path().display())
            })
        };
        let probe = "embree_probe.cpp";
        std::fs::write(out.join(probe), "#include <embree3/rtcore.h>\n")
            .map_err(|error| format!("cannot write in {}: {error}", out.display()))?;
        if !run(&["-E", "-o", "embree_probe.ii", probe])?.status.success() {
            return Err(format!("the header embree3/rtcore.h (package libembree-dev) is missing: {INSTALL}"));
        }
        // The compiler prints the path that it found, or the bare name when it found none.
        let library = run(&["-print-file-name=libembree3.so"])?.stdout;
        if !Path::new(String::from_utf8_lossy(&library).trim()).is_absolute() {
            return Err(format!("the library libembree3.so (package libembree-dev) is missing: {INSTALL}"));
        }
        Ok(())
    }

    /// Rust declarations of `shim.h`.
    fn bind(out: &Path) -> Result<(), String> {
        let header = format!("{DIRECTORY}/shim.h");
        // bindgen panics when it finds no libclang.
        let quiet = std::panic::take_hook();
        std::panic::set_hook(Box::new(|_| {}));
        let bindings = std::panic::catch_unwind(|| {
            bindgen::Builder::default()
                .header(header)
                .allowlist_item("[Ss][Hh][Ii][Mm].*")
                .prepend_enum_name(false)
                .rust_edition(bindgen::RustEdition::Edition2024)
                .formatter(bindgen::Formatter::None)
                .generate()
        });
        std::panic::set_hook(quiet);
        let bindings = bindings
            .map_err(|_| {
                format!("libclang (package libclang-dev), which reads shim.h, is missing: {INSTALL}")
            })?
            .map_err(|error| format!("cannot bind {DIRECTORY}/shim.h: {error}"))?;
        bindings
            .write_to_file(out.join("shim.rs"))
            .map_err(|error| format!("cannot write the bindings in {}: {error}", out.display()))
    }
}
