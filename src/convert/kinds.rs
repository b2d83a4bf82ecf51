//! Which formats there are, and how a file's is told: by content where there is a file, by name where one is to be written.

use super::{bvh_2011, npy, parquet, rays_2011};
use crate::format::FileKind;
use clap::ValueEnum;
use std::path::Path;

/// A format of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// Queries, ours
    Rays,
    /// Queries as RayVisualizer wrote them
    #[value(name = "rays-2011")]
    Rays2011,
    /// An array of NumPy
    Npy,
    /// A table, for pandas, Polars, DuckDB, Spark
    Parquet,
    /// A tree, ours
    Bvh,
    /// A tree as RayVisualizer wrote it
    #[value(name = "bvh-2011")]
    Bvh2011,
    /// Lines, boxes or triangles, for Blender and MeshLab
    Obj,
}

impl Kind {
    /// The name in options, and in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Kind::Rays => "rays",
            Kind::Rays2011 => "rays-2011",
            Kind::Npy => "npy",
            Kind::Parquet => "parquet",
            Kind::Bvh => "bvh",
            Kind::Bvh2011 => "bvh-2011",
            Kind::Obj => "obj",
        }
    }

    /// Whether a file of this format holds a tree, and nothing else.
    pub fn is_tree(self) -> bool {
        matches!(self, Kind::Bvh | Kind::Bvh2011)
    }

    /// What a file's content says that it is. The 2011 rays have no magic: their length and their last word tell.
    pub fn of_content(bytes: &[u8]) -> Option<Kind> {
        match FileKind::of(bytes) {
            Some(FileKind::Rays) => Some(Kind::Rays),
            Some(FileKind::Bvh) => Some(Kind::Bvh),
            None if bytes.starts_with(npy::MAGIC) => Some(Kind::Npy),
            None if bytes.starts_with(parquet::MAGIC) => Some(Kind::Parquet),
            None if bvh_2011::looks_like(bytes) => Some(Kind::Bvh2011),
            None if rays_2011::looks_like(bytes) => Some(Kind::Rays2011),
            None => None,
        }
    }

    /// What a file's name says that it is, or is to be: by its ending.
    pub fn of_name(path: &Path) -> Option<Kind> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "rays" => Some(Kind::Rays),
            "rays2011" => Some(Kind::Rays2011),
            "npy" => Some(Kind::Npy),
            "parquet" => Some(Kind::Parquet),
            "bvh" => Some(Kind::Bvh),
            "bvh2011" => Some(Kind::Bvh2011),
            "obj" => Some(Kind::Obj),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_tell_what_to_write() {
        for (name, expected) in [
            ("casts.rays", Some(Kind::Rays)),
            ("a/b.RAYS2011", Some(Kind::Rays2011)),
            ("casts.rays.npy", Some(Kind::Npy)),
            ("casts.parquet", Some(Kind::Parquet)),
            ("built.bvh", Some(Kind::Bvh)),
            ("built.bvh2011", Some(Kind::Bvh2011)),
            ("boxes.obj", Some(Kind::Obj)),
            ("casts", None),
            ("casts.txt", None),
        ] {
            assert_eq!(Kind::of_name(Path::new(name)), expected, "{name}");
        }
    }
}
