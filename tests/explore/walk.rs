//! Ways through a small tree, worked out by hand.

use embree_trace::explore::walk::{Cursor, Walk};
use embree_trace::geometry::Aabb;
use embree_trace::tree::{Node, Tree};

/// ```text
///          0
///    1     2    3
///   4 5  6 7 8
///    9 10
/// ```
/// with leaves in the order of the file, not depth first. Triangle 1 is in leaves 4 and 10.
fn tree() -> Tree {
    let inner = |first, count| Node::inner(Aabb::EMPTY, first, count);
    let leaf = |first, count| Node::leaf(Aabb::EMPTY, first, count);
    let nodes = vec![
        inner(1, 3),
        inner(4, 2),
        inner(6, 3),
        leaf(0, 1),
        leaf(1, 2),
        inner(9, 2),
        leaf(3, 1),
        leaf(4, 1),
        leaf(5, 1),
        leaf(6, 1),
        leaf(7, 2),
    ];
    Tree { nodes, primitives: vec![0, 1, 2, 3, 4, 5, 6, 7, 1] }
}

#[test]
fn ways_up_down_and_sideways() {
    let tree = tree();
    let walk = Walk::new(tree.view(), 9);
    assert_eq!((walk.parent(0), walk.parent(3), walk.parent(10)), (None, Some(0), Some(5)));
    assert_eq!((walk.children(2), walk.children(3)), (6..9, 0..0));
    assert_eq!(walk.path(10), [0, 1, 5, 10]);
    assert_eq!((walk.level(0), walk.level(10)), (0, 3));
    assert_eq!((walk.number(0), walk.number(8)), (0, 2));
    assert_eq!([1, -1, 3, 4].map(|steps| walk.sibling(6, steps)), [7, 8, 6, 7]);
    assert_eq!(walk.sibling(0, 1), 0);
    assert_eq!((walk.common(4, 10), walk.common(10, 8), walk.common(5, 9), walk.common(3, 3)), (1, 0, 5, 3));
}

#[test]
fn what_is_below() {
    let tree = tree();
    let walk = Walk::new(tree.view(), 9);
    assert_eq!(walk.below(0, 0, 9), [0]);
    assert_eq!(walk.below(0, 2, 9), [4, 5, 6, 7, 8]);
    assert_eq!(walk.below(0, 2, 3), [4, 5, 6]);
    assert_eq!(walk.below(1, 2, 9), [9, 10]);
    assert!(walk.below(3, 1, 9).is_empty());
    assert_eq!(walk.triangles(0), [1, 2, 6, 7, 1, 3, 4, 5, 0]);
    assert_eq!((walk.triangles(1), walk.triangles(10)), (&[1, 2, 6, 7, 1][..], &[7, 1][..]));
    let leaves = |triangle| walk.leaves_of(triangle).collect::<Vec<u32>>();
    assert_eq!((leaves(0), leaves(1), leaves(6), leaves(8)), (vec![3], vec![4, 10], vec![9], vec![]));
}

#[test]
fn a_cursor_remembers_the_way_down() {
    let tree = tree();
    let walk = Walk::new(tree.view(), 9);
    let mut cursor = Cursor::default();
    assert!(!cursor.up());
    assert!(cursor.child(&walk, 0) && cursor.child(&walk, 1) && cursor.child(&walk, 1));
    assert!(!cursor.child(&walk, 0) && !cursor.down(&walk));
    assert_eq!(cursor.path(), [0, 1, 5, 10]);
    assert!(cursor.up() && cursor.up() && cursor.down(&walk) && cursor.down(&walk));
    assert_eq!(cursor.node(), 10);
    assert!(cursor.up() && cursor.sideways(&walk, 1));
    assert_eq!(cursor.path(), [0, 1, 4]);
    assert!(!cursor.down(&walk), "another way was taken");
    assert!(cursor.leaf_of(&walk, 1));
    assert_eq!(cursor.path(), [0, 1, 5, 10], "from one leaf of a triangle to the next");
    assert!(cursor.leaf_of(&walk, 1) && cursor.node() == 4);
    assert!(!cursor.leaf_of(&walk, 8) && cursor.node() == 4);
    cursor.go(&walk, 1);
    assert!(cursor.down(&walk) && cursor.node() == 4);
    assert!(!cursor.child(&walk, 7));
    cursor.go(&walk, 0);
    assert!(!cursor.sideways(&walk, 1));
}

#[test]
fn an_empty_tree_has_a_root() {
    let tree = Tree { nodes: vec![Node::leaf(Aabb::EMPTY, 0, 0)], primitives: vec![] };
    let walk = Walk::new(tree.view(), 2);
    assert_eq!((walk.path(0), walk.triangles(0), walk.leaves_of(1).count()), (vec![0], &[][..], 0));
    assert!(!Cursor::default().leaf_of(&walk, 1));
}
