//! `bvh-compare --mpi` and `bvh-build --mpi` on real ranks: what they write is what one process writes, and one that fails ends all.

mod compare_support;

use compare_support::cli::*;
use std::path::Path;
use std::process::{Command, Output};

const COMPARE: &str = env!("CARGO_BIN_EXE_bvh-compare");
const BUILD: &str = env!("CARGO_BIN_EXE_bvh-build");

/// Runs jobs of `mpirun`: each a number of ranks, a program and its arguments, together in one job.
fn mpirun(directory: &Path, parts: &[(usize, &str, &[&str])]) -> Output {
    let mut command = Command::new("mpirun");
    // More ranks than processors, on one machine without a network, by whoever runs the tests.
    command.args(["--oversubscribe", "--bind-to", "none", "--mca", "btl", "self,vader"]);
    command.env("OMPI_ALLOW_RUN_AS_ROOT", "1").env("OMPI_ALLOW_RUN_AS_ROOT_CONFIRM", "1");
    for (index, (ranks, program, arguments)) in parts.iter().enumerate() {
        if index > 0 {
            command.arg(":");
        }
        command.args(["-n", &ranks.to_string(), program]).args(*arguments);
    }
    command.current_dir(directory).output().expect("mpirun: tools/setup --mpi installs it")
}

fn good(output: Output) -> Vec<u8> {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    output.stdout
}

/// The lines of our commands; mpirun adds its own.
fn errors(output: &Output) -> Vec<String> {
    let said = text(&output.stderr);
    said.lines().filter(|line| line.starts_with("bvh-")).map(str::to_owned).collect()
}

/// Cuts at chunks of 700 queries, five of them: ranks with two, with one, and without any.
#[test]
fn comparisons_are_those_of_one_process() {
    let files = Files::new();
    let directory = files.directory.path();
    let arguments = ["two.bvh", "four.bvh", "casts.rays", "--details", "--format", "json"];
    let selected = [
        "two.bvh",
        "casts.rays",
        "--sample",
        "1000",
        "--held-out",
        "0.5",
        "--packet",
        "16",
        "--format",
        "json",
    ];
    for arguments in [&arguments[..], &selected] {
        let alone = files.json(&arguments[..arguments.len() - 2]);
        for ranks in [2, 4, 7] {
            let output = mpirun(directory, &[(ranks, COMPARE, &[&["--mpi"], arguments].concat())]);
            let report = serde_json::from_slice(&good(output)).expect("JSON, once");
            assert_eq!(timeless(report), timeless(alone.clone()), "{ranks} ranks");
        }
    }

    let pictures = |directory: &str| {
        let list = std::fs::read_dir(files.path(directory))
            .expect("pictures")
            .map(|entry| entry.expect("a picture").path());
        let mut pictures: Vec<_> = list
            .map(|path| (path.file_name().map(ToOwned::to_owned), std::fs::read(path).expect("a picture")))
            .collect();
        pictures.sort();
        pictures
    };
    let heatmap = ["four.bvh", "casts.rays", "--heatmap"];
    good(files.run(&[&heatmap[..], &["alone"]].concat()));
    good(mpirun(directory, &[(3, COMPARE, &[&["--mpi"], &heatmap[..], &["together"]].concat())]));
    assert!(pictures("alone").len() >= 2);
    assert_eq!(pictures("alone"), pictures("together"));
}

#[test]
fn trees_are_those_of_one_process() {
    let files = Files::new();
    let directory = files.directory.path();
    let recipes: [&[&str]; 3] = [
        &[],
        &["--heuristic", "rdh", "--splits", "sweep", "--max-leaf", "4"],
        &["--splits", "spatial", "--train", "0.6", "--train-limit", "1000"],
    ];
    for recipe in recipes {
        let input = |output| [&["two.bvh", output, "--rays", "casts.rays"], recipe].concat();
        let alone =
            Command::new(BUILD).args(input("alone.bvh")).current_dir(directory).output().expect("bvh-build");
        let queries = |said: Vec<u8>| {
            text(&said).lines().find(|line| line.contains("training queries")).map(str::to_owned)
        };
        let said = queries(good(alone));
        assert!(said.is_some());
        for ranks in [2, 4] {
            let arguments = [&["--mpi"], &input("together.bvh")[..]].concat();
            assert_eq!(queries(good(mpirun(directory, &[(ranks, BUILD, &arguments)]))), said);
            assert!(files.read("alone.bvh") == files.read("together.bvh"), "{recipe:?}, {ranks} ranks");
        }
    }
}

/// One line, exit code 2, and nobody waits for ever.
#[test]
fn a_rank_that_fails_ends_all() {
    let files = Files::new();
    let directory = files.directory.path();
    let mut damaged = files.read("casts.rays");
    // In the first chunk, and before the last one.
    let middle = damaged.len() / 2;
    for at in [200, middle] {
        damaged[at] ^= 1;
        files.write("damaged.rays", &damaged);
        damaged[at] ^= 1;
        for (program, arguments) in [
            (COMPARE, &["--mpi", "two.bvh", "damaged.rays"][..]),
            (BUILD, &["--mpi", "two.bvh", "out.bvh", "--rays", "damaged.rays"]),
        ] {
            let output = mpirun(directory, &[(3, program, arguments)]);
            let errors = errors(&output);
            assert_eq!((output.status.code(), errors.len()), (Some(2), 1), "{}", text(&output.stderr));
            assert!(errors[0].contains("damaged.rays") && errors[0].contains("checksum"), "{errors:?}");
            assert!(!files.path("out.bvh").exists());
        }
    }
    // On another machine, say, the file is not there.
    let here = &["--mpi", "two.bvh", "casts.rays"][..];
    let there = &["--mpi", "two.bvh", "nowhere.rays"][..];
    let output = mpirun(directory, &[(1, COMPARE, here), (2, COMPARE, there)]);
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(errors(&output).len(), 1, "{}", text(&output.stderr));
    assert!(
        errors(&output)[0].starts_with("bvh-compare: error: rank 1: nowhere.rays"),
        "{:?}",
        errors(&output)
    );
    // The same everywhere: said as by one process.
    let output = mpirun(directory, &[(3, COMPARE, there)]);
    assert!(errors(&output)[0].starts_with("bvh-compare: error: nowhere.rays"), "{:?}", errors(&output));
    assert_eq!((output.status.code(), errors(&output).len()), (Some(2), 1));
    // Only the first writes, and the others do not build for nothing.
    let output =
        mpirun(directory, &[(2, BUILD, &["--mpi", "two.bvh", "no/where.bvh", "--rays", "casts.rays"])]);
    assert_eq!((output.status.code(), errors(&output).len()), (Some(2), 1), "{}", text(&output.stderr));
}
