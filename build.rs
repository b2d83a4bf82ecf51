//! Builds the shim and the preload library (`embree-shim/`, C++), and their Rust declarations; nothing without the feature
//! `embree`.

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
    /// What the names of the preload library's own sources start with.
    const PRELOAD: &str = "preload";
    /// The versions of Embree that the shim can be built with, the one to be preferred first: only its tree can be read. The
    /// environment variable `EMBREE_MAJOR` asks for one of them.
    const VERSIONS: [&str; 2] = ["3", "4"];
    /// Sources of the shim that the preload library needs, too; none of them calls Embree.
    const SHARED: [&str; 12] = [
        "faces.cpp",
        "live_bvh.cpp",
        "memory.cpp",
        "pages.cpp",
        "plant.cpp",
        "plant_blocks.cpp",
        "plant_check.cpp",
        "plant_cover.cpp",
        "plant_file.cpp",
        "plant_lanes.cpp",
        "plant_tree.cpp",
        "tree.cpp",
    ];
    /// Sources that stand between a query and Embree to record it: only the preload library that records has them.
    const RECORDING: [&str; 4] =
        ["preload_embree4.cpp", "preload_filters.cpp", "preload_queries.cpp", "preload_thread.cpp"];
    /// The source that stands there to take its time: only the preload library that times has it.
    const TIMING: [&str; 1] = ["preload_clock.cpp"];

    /// Checks that the packages are there, compiles the shim and the preload library, binds their C ABI.
    pub fn build() -> Result<(), String> {
        println!("cargo::rerun-if-changed={DIRECTORY}");
        let sources = sources()?;
        let out = PathBuf::from(std::env::var_os("OUT_DIR").ok_or("OUT_DIR is not set")?);
        let mut shim = cc::Build::new();
        // Optimised in the dev profile too: it stands between every query and Embree.
        shim.cpp(true)
            .std("c++17")
            .opt_level(2)
            .pic(true)
            .warnings(true)
            .extra_warnings(true)
            .warnings_into_errors(true);
        let version = embree_version(&shim, &out)?;
        // How `embree-shim` knows it.
        shim.define("EMBREE_MAJOR", version);
        link_preload(&shim, &sources, &out)?;
        shim.files(sources.iter().filter(|source| !is_preload(source)));
        shim.try_compile("embree_trace_shim")
            .map_err(|error| format!("cannot compile {DIRECTORY}: {error}"))?;
        println!("cargo::rustc-link-lib=embree{version}");
        bind(&out)
    }

    fn is_preload(source: &Path) -> bool {
        source.file_name().is_some_and(|name| name.to_string_lossy().starts_with(PRELOAD))
    }

    /// Makes the preload libraries, which go into the binary: one that records, and plants where it is asked to, one that
    /// only plants, and one that plants and takes times.
    fn link_preload(shim: &cc::Build, sources: &[PathBuf], out: &Path) -> Result<(), String> {
        let shared = SHARED.map(|name| Path::new(DIRECTORY).join(name));
        let all: Vec<&PathBuf> = sources.iter().filter(|source| is_preload(source)).chain(&shared).collect();
        let objects = shim
            .clone()
            .flag("-fvisibility=hidden")
            .files(&all)
            .out_dir(out.join("preload"))
            .try_compile_intermediates()
            .map_err(|error| format!("cannot compile the preload library: {error}"))?;
        // Objects come in the order of their sources.
        let without = |left_out: &[&str]| -> Vec<PathBuf> {
            let is_in = |source: &Path| !left_out.iter().any(|name| source.ends_with(name));
            all.iter()
                .zip(&objects)
                .filter(|(source, _)| is_in(source))
                .map(|(_, object)| object.clone())
                .collect()
        };
        link(shim, &without(&TIMING), &out.join("preload.so"))?;
        link(shim, &without(&RECORDING), &out.join("preload_clock.so"))?;
        link(shim, &without(&[&TIMING[..], &RECORDING].concat()), &out.join("preload_plant.so"))
    }

    /// Links a library that is loaded into programs that know nothing of it: it brings its own C++ library, shows nothing but
    /// Embree's names, and needs none of them.
    fn link(shim: &cc::Build, objects: &[PathBuf], library: &Path) -> Result<(), String> {
        let output = shim
            .get_compiler()
            .to_command()
            .args(["-shared", "-static-libstdc++", "-static-libgcc"])
            .arg(format!("-Wl,--version-script={DIRECTORY}/preload.map"))
            .args(["-Wl,-Bsymbolic", "-Wl,--no-undefined", "-o"])
            .arg(library)
            .args(objects)
            .output()
            .map_err(|error| format!("cannot run the C++ compiler: {error}: {INSTALL}"))?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr).trim().replace('\n', " | ");
            return Err(format!("cannot link the preload library: {said}"));
        }
        Ok(())
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

    /// The version of Embree that has its header and its library here. A compiler and both of those are asked for by name: the
    /// errors of a failed build would not say which package is missing.
    fn embree_version(shim: &cc::Build, out: &Path) -> Result<&'static str, String> {
        println!("cargo::rerun-if-env-changed=EMBREE_MAJOR");
        let compiler = shim
            .try_get_compiler()
            .map_err(|error| format!("there is no C++ compiler ({error}): {INSTALL}"))?;
        let run = |arguments: &[&str]| {
            compiler.to_command().args(arguments).current_dir(out).output().map_err(|error| {
                format!("cannot run the C++ compiler {}: {error}: {INSTALL}", compiler.path().display())
            })
        };
        let find = |version| {
            let (header, library) = (format!("embree{version}/rtcore.h"), format!("libembree{version}.so"));
            let probe = "embree_probe.cpp";
            std::fs::write(out.join(probe), format!("#include <{header}>\n"))
                .map_err(|error| format!("cannot write in {}: {error}", out.display()))?;
            if !run(&["-E", "-o", "embree_probe.ii", probe])?.status.success() {
                return Err(format!("the header {header} (package libembree-dev) is missing: {INSTALL}"));
            }
            // The compiler prints the path that it found, or the bare name when it found none.
            let found = run(&[&format!("-print-file-name={library}")])?.stdout;
            if !Path::new(String::from_utf8_lossy(&found).trim()).is_absolute() {
                return Err(format!("the library {library} (package libembree-dev) is missing: {INSTALL}"));
            }
            Ok(version)
        };
        match std::env::var("EMBREE_MAJOR") {
            Ok(asked) => {
                let version = VERSIONS.into_iter().find(|&version| version == asked);
                find(version.ok_or_else(|| format!("EMBREE_MAJOR is neither 3 nor 4, but {asked:?}"))?)
            }
            // Where there is neither, what Embree 3 lacks is told.
            Err(_) => find(VERSIONS[0]).or_else(|missing| find(VERSIONS[1]).map_err(|_| missing)),
        }
    }

    /// Rust declarations of `shim.h` and `exchange.h`, which includes it.
    fn bind(out: &Path) -> Result<(), String> {
        let header = format!("{DIRECTORY}/exchange.h");
        // bindgen panics when it finds no libclang.
        let quiet = std::panic::take_hook();
        std::panic::set_hook(Box::new(|_| {}));
        let bindings = std::panic::catch_unwind(|| {
            bindgen::Builder::default()
                .header(header)
                .derive_default(true)
                .allowlist_item("([Ss][Hh][Ii][Mm]|Exchange|EXCHANGE).*")
                .prepend_enum_name(false)
                .rust_edition(bindgen::RustEdition::Edition2024)
                .formatter(bindgen::Formatter::None)
                .generate()
        });
        std::panic::set_hook(quiet);
        let bindings = bindings
            .map_err(|_| {
                format!("libclang (package libclang-dev), which reads exchange.h, is missing: {INSTALL}")
            })?
            .map_err(|error| format!("cannot bind {DIRECTORY}/exchange.h: {error}"))?;
        bindings
            .write_to_file(out.join("shim.rs"))
            .map_err(|error| format!("cannot write the bindings in {}: {error}", out.display()))
    }
}
