//! A real window: `bvh-view` on a display in memory (Xvfb), driven by keys and mouse (xdotool), looked at through the display's own pixels.

use crate::room::Room;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const PATIENCE: Duration = Duration::from_secs(120);

/// A program that ends with the test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

struct Display {
    number: String,
    pixels: PathBuf,
    _server: Running,
}

impl Display {
    fn start(directory: &Path) -> Display {
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-screen", "0", "900x600x24", "-nolisten", "tcp", "-fbdir"])
            .arg(directory)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("Xvfb: tools/setup --tests installs it");
        let mut line = String::new();
        let output = server.stdout.take().expect("a pipe");
        BufReader::new(output).read_line(&mut line).expect("the number of the display");
        let number = format!(":{}", line.trim());
        Display { number, pixels: directory.join("Xvfb_screen0"), _server: Running(server) }
    }

    /// What is on the display: the pixels of an XWD file, whose header is of big-endian words.
    fn picture(&self) -> Vec<u8> {
        let bytes = std::fs::read(&self.pixels).expect("the display's pixels");
        let word = |index: usize| {
            u32::from_be_bytes(bytes[4 * index..4 * index + 4].try_into().expect("four bytes")) as usize
        };
        let (header, colors) = (word(0), word(19));
        bytes[header + 12 * colors..].to_vec()
    }

    fn tell(&self, arguments: &[&str]) {
        let status = Command::new("xdotool").args(arguments).env("DISPLAY", &self.number).status();
        assert!(status.expect("xdotool: tools/setup --tests installs it").success(), "{arguments:?}");
    }

    /// Waits for a picture that stands still and of which at least `changed` bytes are not those of `before`.
    fn changed(&self, before: &[u8], changed: usize, what: &str) -> Vec<u8> {
        let started = Instant::now();
        let mut last = self.picture();
        loop {
            std::thread::sleep(Duration::from_millis(400));
            let now = self.picture();
            let differs = now.iter().zip(before).filter(|(a, b)| a != b).count();
            if differs >= changed && now == last {
                return now;
            }
            assert!(started.elapsed() < PATIENCE, "{what}: {differs} bytes have changed");
            last = now;
        }
    }
}

/// Opens files in a window that keys go to: nobody manages windows here, so it has to be told.
fn open(room: &Room, display: &Display, files: &[&str], changed: usize) -> (Running, Vec<u8>) {
    let empty = display.picture();
    let viewer = Running(
        Command::new(env!("CARGO_BIN_EXE_bvh-view"))
            .args(files)
            .args(["--size", "880x560"])
            .current_dir(room.directory.path())
            .env("DISPLAY", &display.number)
            .env("XDG_RUNTIME_DIR", room.directory.path())
            .env_remove("WAYLAND_DISPLAY")
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("running bvh-view"),
    );
    let start = display.changed(&empty, changed, "the window");
    display.tell(&["search", "--sync", "--name", "bvh-view", "windowfocus"]);
    (viewer, start)
}

#[test]
fn a_bad_file_is_told_in_the_window_and_after_it() {
    let room = Room::new();
    room.write("broken.bvh", b"\x89BVH\r\n\x1a\nand no more");
    let display = Display::start(room.directory.path());
    let (mut viewer, _) = open(&room, &display, &["broken.bvh"], 2_000);
    // A window that is still empty does not listen: again and again.
    let started = Instant::now();
    let status = loop {
        let pressed =
            Command::new("xdotool").args(["key", "Escape"]).env("DISPLAY", &display.number).status();
        assert!(pressed.is_ok() && started.elapsed() < PATIENCE, "the window does not close");
        std::thread::sleep(Duration::from_millis(300));
        if let Some(status) = viewer.0.try_wait().expect("its state") {
            break status;
        }
    };
    let mut said = String::new();
    let mut errors = viewer.0.stderr.take().expect("a pipe");
    std::io::Read::read_to_string(&mut errors, &mut said).expect("what it says");
    assert_eq!(status.code(), Some(2), "{said}");
    let lines: Vec<&str> = said.lines().filter(|line| line.starts_with("bvh-view: error: ")).collect();
    assert!(lines.len() == 1 && lines[0].contains("broken.bvh"), "{said}");
}

#[test]
fn keys_and_mouse_change_a_real_window() {
    let room = Room::new();
    let display = Display::start(room.directory.path());
    let (_viewer, start) = open(&room, &display, &["sweep.bvh", "casts.rays"], 100_000);
    // The mouse: somewhere in the picture, between the panels.
    display.tell(&["mousemove", "420", "300"]);
    display.tell(&["key", "2"]);
    let explore = display.changed(&start, 50_000, "mode explore");
    display.tell(&["key", "Right"]);
    let child = display.changed(&explore, 5_000, "a child");
    // Not all within one frame, however slow: a drag takes its time.
    let pause = || std::thread::sleep(Duration::from_millis(300));
    display.tell(&["mousedown", "1"]);
    pause();
    for step in 1..=8 {
        let x = (420 + 10 * step).to_string();
        display.tell(&["mousemove", &x, "300"]);
        pause();
    }
    display.tell(&["mouseup", "1"]);
    let turned = display.changed(&child, 50_000, "another view");
    display.tell(&["key", "question"]);
    display.changed(&turned, 20_000, "the list of keys");
}
