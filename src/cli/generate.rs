//! Man pages and shell completions, from the definitions that the commands parse their words with.
//!
//! `COMMAND --generate PREFIX`, a hidden option of every binary, writes them where a prefix such as `/usr` has them:
//! one man page for the command and one for each of its subcommands, and completions for bash, zsh and fish.

use super::Failure;
use crate::files::{FileError, OutputFile};
use clap::Command;
use clap_complete::aot::{Bash, Fish, Zsh, generate as completions};
use clap_mangen::Man;
use std::ffi::OsString;
use std::fs;
use std::io::{self, Write};
use std::path::Path;

/// The prefix, when that is what the words ask for: nothing else may stand beside it.
pub(super) fn wanted(words: &[OsString]) -> Option<&Path> {
    match words {
        [_, option, prefix] if option == "--generate" => Some(Path::new(prefix)),
        _ => None,
    }
}

/// Writes the man pages and completions of a command below `prefix`.
///
/// # Errors
/// When a directory or a file cannot be made.
pub(super) fn write(program: &'static str, command: Command, prefix: &Path) -> Result<(), Failure> {
    // The definitions of most binaries leave the name to clap, which takes the package's.
    let mut command = command.name(program).disable_help_subcommand(true);
    let mut texts = [Vec::new(), Vec::new(), Vec::new()];
    let [bash, zsh, fish] = &mut texts;
    completions(Bash, &mut command, program, bash);
    completions(Zsh, &mut command, program, zsh);
    completions(Fish, &mut command, program, fish);
    let [bash, zsh, fish] = texts;
    put(prefix, "share/bash-completion/completions", program, &bash)?;
    put(prefix, "share/zsh/vendor-completions", &format!("_{program}"), &zsh)?;
    put(prefix, "share/fish/vendor_completions.d", &format!("{program}.fish"), &fish)?;
    pages(&command, prefix)
}

/// The page of a command that is built, and those of its subcommands.
fn pages(command: &Command, prefix: &Path) -> Result<(), Failure> {
    for below in command.get_subcommands() {
        pages(below, prefix)?;
    }
    let man = Man::new(command.clone()).manual("embree-trace").source("embree-trace");
    put(prefix, "share/man/man1", &man.get_filename(), &page(command, &man)?)
}

fn page(command: &Command, man: &Man) -> io::Result<Vec<u8>> {
    let mut out = Vec::new();
    man.render_title(&mut out)?;
    man.render_name_section(&mut out)?;
    man.render_synopsis_section(&mut out)?;
    man.render_description_section(&mut out)?;
    man.render_options_section(&mut out)?;
    if command.has_subcommands() {
        man.render_subcommands_section(&mut out)?;
    }
    if let Some(text) = command.get_after_help() {
        // The crate's own rendering fills these lines up to paragraphs, and examples are lines.
        write_lines(&mut out, &text.to_string())?;
    }
    Ok(out)
}

/// Text as it stands, line for line; a line of its own that ends with a colon (`Examples:`) begins a section.
fn write_lines(out: &mut impl Write, text: &str) -> io::Result<()> {
    for (number, line) in text.lines().enumerate() {
        let heading = line.strip_suffix(':').filter(|heading| !heading.starts_with(' '));
        if let Some(heading) = heading {
            writeln!(out, ".fi\n.SH {}\n.nf", roff(&heading.to_uppercase()))?;
        } else if number == 0 {
            writeln!(out, ".SH NOTES\n.nf\n{}", roff(line))?;
        } else {
            writeln!(out, "{}", roff(line))?;
        }
    }
    writeln!(out, ".fi")
}

/// A line that the formatter shows as it is: `\&` keeps a dot or a quote at its start from being a request.
fn roff(line: &str) -> String {
    format!(r"\&{}", line.replace('\\', r"\e").replace('-', r"\-").replace('\'', r"\(aq"))
}

fn put(prefix: &Path, directory: &str, name: &str, text: &[u8]) -> Result<(), Failure> {
    let directory = prefix.join(directory);
    fs::create_dir_all(&directory)
        .map_err(|error| FileError::new(&directory, "create the directory", error))?;
    OutputFile::create(&directory.join(name))?.commit_with(|out| out.write_all(text))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{Parser, Subcommand};

    #[derive(Parser)]
    #[command(about = "Counts things", after_help = "Examples:\n  count --all\n.dotted 'x' C:\\\\ end")]
    struct Arguments {
        /// Counts every thing
        #[arg(long)]
        all: bool,
        #[command(subcommand)]
        below: Below,
    }

    #[derive(Subcommand)]
    enum Below {
        /// Counts apples
        Apples,
    }

    #[test]
    fn only_the_option_with_one_prefix_asks_for_them() {
        let words = |line: &str| line.split(' ').map(OsString::from).collect::<Vec<OsString>>();
        assert_eq!(wanted(&words("count --generate /usr")), Some(Path::new("/usr")));
        for line in ["count", "count --generate", "count a --generate", "count --generate a b"] {
            assert_eq!(wanted(&words(line)), None, "{line}");
        }
    }

    #[test]
    fn a_prefix_gets_every_page_and_completion() {
        let prefix = tempfile::tempdir().expect("a temporary directory");
        write("count", <Arguments as clap::CommandFactory>::command(), prefix.path()).expect("written");
        let read = |path: &str| fs::read_to_string(prefix.path().join(path)).expect(path);
        let page = read("share/man/man1/count.1");
        let said = |page: &str, text: &str| assert!(page.contains(text), "{text} is not in {page}");
        said(&page, "Counts things");
        said(&page, r"\-\-all");
        said(&page, "count\\-apples");
        said(&page, ".SH \\&EXAMPLES\n.nf\n\\&  count \\-\\-all\n\\&.dotted \\(aqx\\(aq C:\\e\\e end\n.fi");
        said(&read("share/man/man1/count-apples.1"), "Counts apples");
        for path in [
            "share/bash-completion/completions/count",
            "share/zsh/vendor-completions/_count",
            "share/fish/vendor_completions.d/count.fish",
        ] {
            let text = read(path);
            assert!(text.contains("apples") && text.contains("all"), "{path}: {text}");
        }
    }

    #[test]
    fn a_prefix_that_is_a_file_is_one_error() {
        let file = tempfile::NamedTempFile::new().expect("a temporary file");
        let failure = write("count", <Arguments as clap::CommandFactory>::command(), file.path());
        let line = failure.expect_err("not a directory").line;
        assert!(line.contains("cannot create the directory"), "{line}");
    }
}
