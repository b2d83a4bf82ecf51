//! Two trees, section by section and element by element, in file order.

use super::{DiffError, First, Report, Tolerance, Value};
use crate::format::bvh::{Bvh, Geometry};
use crate::geometry::Triangle;
use crate::tree::Node;

/// Compares two files. What counts: nodes, their boxes, primitives, triangles, geometries and traversal orders.
/// What is noted: flags. What is ignored: producer and `META`, where the time of building stands.
pub(super) fn compare(a: &[u8], b: &[u8], tolerance: Tolerance) -> Result<Report, DiffError> {
    let a = Bvh::parse(a).map_err(DiffError::A)?;
    let b = Bvh::parse(b).map_err(DiffError::B)?;
    let (count_a, count_b) = (a.tree.nodes.len() as u64, b.tree.nodes.len() as u64);
    let mut report = Report { unit: "nodes", count_a, count_b, ..Report::default() };
    report.note("flags", format!("{:#x}", a.header.flags), format!("{:#x}", b.header.flags));

    compare_elements("nodes", a.tree.nodes, b.tree.nodes, &mut report, |a, b| node_values(a, b, tolerance));
    compare_elements("primitives", a.tree.primitives, b.tree.primitives, &mut report, |a, b| {
        unequal("primitive", a, b)
    });
    compare_elements("triangles", a.triangles, b.triangles, &mut report, |a, b| {
        triangle_values(a, b, tolerance)
    });
    compare_elements("geometries", a.geometries, b.geometries, &mut report, geometry_values);
    match (a.order, b.order) {
        (None, None) => {}
        (Some(a), Some(b)) => compare_elements("orders", a, b, &mut report, |a, b| unequal("order", a, b)),
        (a, b) => {
            let text = |order: Option<&[u8]>| if order.is_some() { "present" } else { "absent" };
            let value = Value::new("ORDR", text(a), text(b));
            report.differ(&["order"], || First { element: "sections".into(), values: vec![value] });
        }
    }
    Ok(report)
}

type Differences = Vec<(&'static str, String, String)>;

fn compare_elements<T: bytemuck::Pod>(
    name: &'static str,
    a: &[T],
    b: &[T],
    report: &mut Report,
    values: impl Fn(&T, &T) -> Differences,
) {
    for (index, (one, other)) in a.iter().zip(b).enumerate() {
        if bytemuck::bytes_of(one) == bytemuck::bytes_of(other) {
            continue;
        }
        let values = values(one, other);
        if values.is_empty() {
            continue;
        }
        let names: Vec<&'static str> = values.iter().map(|(name, _, _)| *name).collect();
        report.differ(&names, || First {
            element: format!("{name} {index}"),
            values: values.iter().map(|(name, a, b)| Value::new(name, a, b)).collect(),
        });
    }
    report.differ_in_length(name, a.len() as u64, b.len() as u64);
}

fn unequal<T: PartialEq + ToString>(name: &'static str, a: &T, b: &T) -> Differences {
    if a == b { Vec::new() } else { vec![(name, a.to_string(), b.to_string())] }
}

fn node_values(a: &Node, b: &Node, tolerance: Tolerance) -> Differences {
    let mut values = Vec::new();
    let bounds = |node: &Node| format!("{} to {}", node.lower, node.upper);
    if !(tolerance.equal_vectors(a.lower, b.lower) && tolerance.equal_vectors(a.upper, b.upper)) {
        values.push(("box", bounds(a), bounds(b)));
    }
    if (a.first, a.count) != (b.first, b.count) {
        let text = |node: &Node| {
            let kind = if node.is_leaf() { "leaf of primitives" } else { "inner node of children" };
            format!("{kind} {} to {}", node.range().start, node.range().end)
        };
        values.push(("structure", text(a), text(b)));
    }
    values
}

fn triangle_values(a: &Triangle, b: &Triangle, tolerance: Tolerance) -> Differences {
    let same = a.0.iter().zip(b.0).all(|(&a, b)| tolerance.equal_vectors(a, b));
    let text = |triangle: &Triangle| format!("{:?}", triangle.0.map(|vertex| vertex.to_array()));
    if same { Vec::new() } else { vec![("triangle", text(a), text(b))] }
}

fn geometry_values(a: &Geometry, b: &Geometry) -> Differences {
    let mut values = Vec::new();
    let fields = [
        ("instance", a.instance, b.instance),
        ("geometry", a.geometry, b.geometry),
        ("first triangle", a.first_triangle, b.first_triangle),
        ("triangle count", a.triangle_count, b.triangle_count),
        ("mask", a.mask, b.mask),
        ("mask of its instance", a.masks()[1], b.masks()[1]),
        ("geometry kind", a.kind, b.kind),
    ];
    for (name, a, b) in fields {
        values.extend(unequal(name, &a, &b));
    }
    values
}
