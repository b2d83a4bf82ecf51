//! How the triangles of a scene file are numbered: in the order of its faces, as the files of 2011 do, and by part, as `TRIS` does.

use crate::format::bvh::Geometry;
use crate::geometry::Triangle;
use crate::mesh::{self, MeshError, obj::Options};
use std::collections::HashMap;
use std::path::Path;
use thiserror::Error;

/// Why a scene's triangles cannot be numbered, or are not those of a tree.
#[derive(Debug, Error)]
pub enum NumberingError {
    #[error(transparent)]
    Mesh(#[from] MeshError),
    #[error("two of its parts have the same name, so its faces cannot be told apart by part: rename one")]
    Names,
    #[error(
        "its {mesh} triangles are not the {tree} of the tree, in value or in order: give the scene that was recorded, or none"
    )]
    OtherTriangles { mesh: usize, tree: usize },
}

/// A scene's triangles in the order of `TRIS`, and the number of each in its file.
#[derive(Clone, Debug)]
pub struct Numbering {
    pub triangles: Vec<Triangle>,
    pub geometries: Vec<Geometry>,
    /// By place in `triangles`: place in the file.
    pub in_file: Vec<u32>,
}

impl Numbering {
    /// Reads a scene, every face cut into triangles.
    ///
    /// # Errors
    /// When it cannot be read.
    pub fn read(path: &Path) -> Result<Numbering, NumberingError> {
        let (by_part, _) = mesh::read(path)?;
        let (in_order, _) = mesh::read_with(path, &Options { file_order: true, ..Options::default() })?;
        let triangles = by_part.triangles();
        let listed = in_order.triangles();

        // The stretches of each part, joined, are the part.
        let mut part_of = HashMap::new();
        let mut numbers: Vec<Vec<u32>> = Vec::new();
        let mut next = 0;
        for stretch in &in_order.parts {
            let part = *part_of.entry((&stretch.name, stretch.material)).or_insert_with(|| {
                numbers.push(Vec::new());
                numbers.len() - 1
            });
            let count = stretch.triangle_count() as u32;
            numbers[part].extend(next..next + count);
            next += count;
        }
        let in_file = numbers.concat();
        let same = in_file.len() == triangles.len()
            && in_file
                .iter()
                .zip(&triangles)
                .all(|(&number, triangle)| same(&listed[number as usize], triangle));
        if !same {
            return Err(NumberingError::Names);
        }
        Ok(Numbering { triangles, geometries: by_part.geometries(u32::MAX), in_file })
    }

    /// Whether a tree's triangles are these.
    ///
    /// # Errors
    /// When they are not.
    pub fn check(&self, tree: &[Triangle]) -> Result<(), NumberingError> {
        let other = NumberingError::OtherTriangles { mesh: self.triangles.len(), tree: tree.len() };
        let equal =
            tree.len() == self.triangles.len() && tree.iter().zip(&self.triangles).all(|(a, b)| same(a, b));
        if equal { Ok(()) } else { Err(other) }
    }

    /// The triangles in the order of the file.
    pub fn listed(&self) -> Vec<Triangle> {
        let mut listed = self.triangles.clone();
        for (triangle, &number) in self.triangles.iter().zip(&self.in_file) {
            listed[number as usize] = *triangle;
        }
        listed
    }

    /// By place in the file: place in `triangles`.
    pub fn in_tree(&self) -> Vec<u32> {
        let mut in_tree = vec![0; self.in_file.len()];
        for (index, &number) in self.in_file.iter().enumerate() {
            in_tree[number as usize] = index as u32;
        }
        in_tree
    }
}

/// The same bits: files hold NaN, too.
fn same(a: &Triangle, b: &Triangle) -> bool {
    bytemuck::bytes_of(a) == bytemuck::bytes_of(b)
}
