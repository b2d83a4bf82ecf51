//! What a tree file of 2011 is once its reader has accepted it: a tree that our own format takes.

use super::{bvh, check_line};
use embree_trace::convert::bvh_2011;
use embree_trace::format::bvh::{Contents, flag, write};
use embree_trace::geometry::{Triangle, Vec3};

/// Eight triangles in a row, the scene of every input.
fn scene() -> Vec<Triangle> {
    let triangle =
        |x: f32| Triangle([Vec3::new(x, 0.0, 0.0), Vec3::new(x + 1.0, 0.0, 0.0), Vec3::new(x, 1.0, 0.5)]);
    (0..8u8).map(|number| triangle(number.into())).collect()
}

/// Reads any bytes as a tree over eight triangles.
///
/// # Panics
/// Where a promise of the reader does not hold.
pub fn check(bytes: &[u8]) {
    let triangles = scene();
    let read = match bvh_2011::read(bytes, &triangles) {
        Ok(read) => read,
        Err(error) => return check_line(&error),
    };
    let contents = Contents {
        tree: read.tree.view(),
        triangles: &triangles,
        geometries: &[],
        order: read.order.as_deref(),
        meta: None,
        flags: if read.duplicates { flag::SPATIAL_SPLITS } else { 0 },
        producer: "",
    };
    let mut ours = Vec::new();
    if let Err(error) = write(&mut ours, &contents) {
        panic!("our writer refuses what was read: {error}");
    }
    bvh::check(&ours);

    // Each branch has two children by the format, so the tree goes back, and is the same when read again.
    let mut back = Vec::new();
    if let Err(error) = bvh_2011::write(&mut back, &contents, |triangle| triangle) {
        panic!("what was read cannot be written: {error}");
    }
    match bvh_2011::read(&back, &triangles) {
        Ok(again) => {
            assert_eq!(again.tree.primitives, read.tree.primitives);
            assert_eq!(
                (again.tree.nodes.len(), again.order.is_some()),
                (read.tree.nodes.len(), read.order.is_some())
            );
        }
        Err(error) => panic!("what was written is refused: {error}"),
    }
}
