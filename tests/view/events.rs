//! Keys and mouse, fed to a window in memory.

use crate::room::{PATIENCE, Room, shown, view};
use eframe::egui::{Event, Key, Modifiers, MouseWheelUnit, PointerButton, Pos2, pos2, vec2};
use embree_trace::traverse::Traversal;
use embree_trace::view::modes::ModeName;
use embree_trace::view::offscreen::Offscreen;
use embree_trace::view::shared::Shared;
use embree_trace::view::wishes::Wishes;

/// The middle of the picture in a window without panels.
const MIDDLE: Pos2 = pos2(150.0, 150.0);

fn window(room: &Room, files: &[&str]) -> Offscreen {
    let wishes = Wishes { no_panels: true, ..Wishes::default() };
    shown(room.paths(files), wishes, [300, 300])
}

fn shared(window: &mut Offscreen) -> &mut Shared {
    &mut window.viewer.session().expect("files are open").shared
}

fn mode(window: &mut Offscreen) -> ModeName {
    window.viewer.session().expect("files are open").modes.name()
}

fn key(key: Key, modifiers: Modifiers) -> Vec<Event> {
    let event = |pressed| Event::Key { key, physical_key: None, pressed, repeat: false, modifiers };
    vec![Event::ModifiersChanged(modifiers), event(true), event(false)]
}

fn press(window: &mut Offscreen, pressed: Key) {
    window.frame(key(pressed, Modifiers::NONE));
    window.frame(Vec::new());
}

fn button(pos: Pos2, pressed: bool) -> Event {
    Event::PointerButton { pos, button: PointerButton::Primary, pressed, modifiers: Modifiers::NONE }
}

fn click(window: &mut Offscreen, pos: Pos2) {
    window.frame(vec![Event::PointerMoved(pos)]);
    window.frame(vec![button(pos, true)]);
    window.frame(vec![button(pos, false)]);
    window.frame(Vec::new());
}

#[test]
fn dragging_and_the_wheel_move_the_camera_and_the_picture() {
    let room = Room::new();
    let mut window = window(&room, &["sweep.bvh", "casts.rays"]);
    let start = shared(&mut window).camera.view;
    assert!((start.eye - view().eye).length() < 1e-3, "the recording's camera: {start:?}");
    let before = window.picture().expect("a picture");
    window.frame(vec![Event::PointerMoved(MIDDLE)]);
    window.frame(vec![button(MIDDLE, true)]);
    for step in 1..=10 {
        window.frame(vec![Event::PointerMoved(MIDDLE + vec2(6.0 * step as f32, 2.0 * step as f32))]);
    }
    window.frame(vec![button(MIDDLE + vec2(60.0, 20.0), false)]);
    let turned = shared(&mut window).camera.view;
    assert!((turned.target - start.target).length() < 1e-4, "it goes round the target");
    let distances = [start, turned].map(|view| (view.eye - view.target).length());
    assert!((distances[0] - distances[1]).abs() < 1e-2 && (turned.eye - start.eye).length() > 1.0);
    // Dragged to the right and down: one looks from the left of where one was, and from above.
    assert!(turned.eye.y > start.eye.y);
    window.settle(PATIENCE).expect("a picture");
    let after = window.picture().expect("a picture");
    let changed = before.pixels().zip(after.pixels()).filter(|(a, b)| a != b).count();
    assert!(changed > 300 * 300 / 4, "{changed}");

    window.frame(vec![Event::MouseWheel {
        unit: MouseWheelUnit::Line,
        delta: vec2(0.0, 3.0),
        phase: eframe::egui::TouchPhase::Move,
        source: eframe::egui::MouseWheelSource::Wheel,
        modifiers: Modifiers::NONE,
    }]);
    for _ in 0..30 {
        window.frame(Vec::new());
    }
    let nearer = shared(&mut window).camera.view;
    assert!((nearer.eye - nearer.target).length() < 0.95 * distances[1]);
}

#[test]
fn views_are_kept_and_flown_away_from() {
    let room = Room::new();
    let mut window = window(&room, &["sweep.bvh"]);
    window.frame(key(Key::Num5, Modifiers::COMMAND));
    let kept = shared(&mut window).camera.view;
    let held = |pressed| Event::Key {
        key: Key::W,
        physical_key: None,
        pressed,
        repeat: false,
        modifiers: Modifiers::NONE,
    };
    window.frame(vec![Event::ModifiersChanged(Modifiers::NONE), held(true)]);
    window.frame(Vec::new());
    window.frame(vec![held(false)]);
    let flown = shared(&mut window).camera.view;
    assert!((flown.eye - kept.eye).dot(kept.target - kept.eye) > 0.0, "forward");
    window.frame(key(Key::Num5, Modifiers::ALT));
    assert_eq!(shared(&mut window).camera.view, kept);
    press(&mut window, Key::Home);
    assert_ne!(shared(&mut window).camera.view.eye, kept.eye);
}

#[test]
fn the_tree_is_walked_by_keys_and_clicks() {
    let room = Room::new();
    let mut window = window(&room, &["sweep.bvh", "casts.rays"]);
    press(&mut window, Key::Num2);
    assert_eq!(mode(&mut window), ModeName::Explore);
    assert!(shared(&mut window).layers.boxes.visible);
    let nodes = shared(&mut window).tree().bvh.tree.nodes;
    press(&mut window, Key::ArrowRight);
    assert_eq!(shared(&mut window).node(), nodes[0].first + 1);
    press(&mut window, Key::Comma);
    assert_eq!(shared(&mut window).node(), nodes[0].first);
    press(&mut window, Key::ArrowUp);
    assert_eq!(shared(&mut window).node(), 0);
    press(&mut window, Key::ArrowUp);
    assert_eq!(shared(&mut window).node(), 0, "there is nothing above the root");
    press(&mut window, Key::ArrowDown);
    assert_eq!(shared(&mut window).node(), nodes[0].first, "back to where one came from");

    // From the root, each click goes one level down towards the triangle under the mouse.
    press(&mut window, Key::ArrowUp);
    for level in 1..=2 {
        // Apart in time, so that two clicks are not a double one.
        std::thread::sleep(std::time::Duration::from_millis(700));
        click(&mut window, MIDDLE);
        let shared = shared(&mut window);
        assert_eq!(shared.tree().walk.level(shared.node()), level);
        let triangle = shared.hovered.and_then(|spot| spot.triangle).expect("something in the middle");
        assert!(shared.tree().walk.triangles(shared.node()).contains(&triangle));
    }
}

#[test]
fn a_query_is_followed_step_by_step() {
    let room = Room::new();
    let mut window = window(&room, &["sweep.bvh", "casts.rays"]);
    press(&mut window, Key::Num4);
    assert_eq!(mode(&mut window), ModeName::Query);
    window.settle(PATIENCE).expect("pixels are found");
    click(&mut window, MIDDLE);
    let empty = window.picture().expect("a picture");
    press(&mut window, Key::Space);
    press(&mut window, Key::Space);
    window.frame(Vec::new());
    let later = window.picture().expect("a picture");
    assert_ne!(empty, later, "another step is another picture");
    press(&mut window, Key::Backspace);
    press(&mut window, Key::Backspace);
    window.frame(Vec::new());
    assert_eq!(window.picture().expect("a picture"), empty, "and back");
    press(&mut window, Key::O);
    assert_eq!(shared(&mut window).traversal, Traversal::RayOrder);
}

#[test]
fn cameras_of_two_trees_are_one() {
    let room = Room::new();
    let wishes = Wishes { no_panels: true, ..Wishes::default() };
    let mut window = shown(room.paths(&["sweep.bvh", "binned.bvh"]), wishes, [402, 200]);
    let image = window.picture().expect("a picture");
    // Below the captions, both show the same.
    let differs = (60..200).flat_map(|y| (0..200).map(move |x| (x, y))).filter(|&(x, y)| {
        image.get_pixel(x, y).0.iter().zip(image.get_pixel(x + 202, y).0).any(|(&a, b)| a.abs_diff(b) > 24)
    });
    assert!(differs.count() < 140 * 200 / 50);
    press(&mut window, Key::V);
    assert_eq!(shared(&mut window).active, 1);
}

#[test]
fn the_list_of_keys_comes_and_goes() {
    let room = Room::new();
    let mut window = window(&room, &["sweep.bvh"]);
    let before = window.picture().expect("a picture");
    for _ in 0..2 {
        press(&mut window, Key::Questionmark);
        for _ in 0..20 {
            std::thread::sleep(std::time::Duration::from_millis(20));
            window.frame(Vec::new());
        }
        let open = window.picture().expect("a picture");
        let changed = before.pixels().zip(open.pixels()).filter(|(a, b)| a != b).count();
        if changed > 5_000 {
            continue;
        }
        assert!(changed < 100, "{changed}");
        return;
    }
    panic!("the list does not go");
}
