//! The four shapes of the paper's section 5.2, and the rays that it shoots at them.
//!
//! A [`Shape`] and one `Trial`'s random numbers make a [`Setup`]: triangles, and an unaligned circular frustum of rays.

use crate::geometry::{DVec3, Ray, Triangle, Vec3};
use crate::random::Random;
use std::f64::consts::TAU;

/// Rays of one trial.
pub const RAYS: usize = 3000;

/// What is shot at. Lengths are in the paper's units: radii of 100.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Shape {
    Sphere,
    Plane,
    Hemisphere,
    Tube,
}

impl Shape {
    pub const ALL: [Shape; 4] = [Shape::Sphere, Shape::Plane, Shape::Hemisphere, Shape::Tube];

    pub fn name(self) -> &'static str {
        match self {
            Shape::Sphere => "sphere",
            Shape::Plane => "plane",
            Shape::Hemisphere => "hemisphere",
            Shape::Tube => "tube",
        }
    }

    /// What rows of optimised trees are called.
    pub fn optimized_name(self) -> &'static str {
        match self {
            Shape::Sphere => "sphere-optimized",
            Shape::Plane => "plane-optimized",
            Shape::Hemisphere => "hemisphere-optimized",
            Shape::Tube => "tube-optimized",
        }
    }
}

/// An unaligned circular frustum: origins uniform in one disk and, independently, targets uniform in another, both across
/// the line between their centres. Rays are unbounded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frustum {
    pub from: DVec3,
    pub from_radius: f64,
    pub to: DVec3,
    pub to_radius: f64,
}

impl Frustum {
    /// `count` rays. The direction is target - origin, not normalised.
    pub fn rays(&self, count: usize, random: &mut Random) -> Vec<Ray> {
        let axis = self.to - self.from;
        let ray = |_| {
            let origin = random.in_disk(self.from, self.from_radius, axis);
            let target = random.in_disk(self.to, self.to_radius, axis);
            Ray { origin, tnear: 0.0, direction: target - origin, tfar: f32::INFINITY }
        };
        (0..count).map(ray).collect()
    }
}

/// Geometry and rays of one trial.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    pub triangles: Vec<Triangle>,
    pub frustum: Frustum,
}

impl Setup {
    /// What a trial at `focus` (0 to 1) looks like. Everything that varies between trials is drawn from `random`.
    pub fn new(shape: Shape, focus: f64, random: &mut Random) -> Setup {
        let frustum = |from, from_radius, to, to_radius| Frustum { from, from_radius, to, to_radius };
        match shape {
            Shape::Sphere => {
                let v = direction(random);
                Setup { triangles: sphere(), frustum: frustum(400.0 * v, 80.0, 100.0 * v, 80.0 * focus) }
            }
            Shape::Plane => {
                let v = across(random);
                let from = 120.0 * v + DVec3::new(300.0, 0.0, 0.0);
                Setup { triangles: plane(), frustum: frustum(from, 80.0, 120.0 * v, 80.0 * focus) }
            }
            Shape::Hemisphere => {
                let (r, t) = (0.5 * random.uniform().sqrt(), TAU * random.uniform());
                let v = DVec3::new(-(1.0 - r * r).sqrt(), r * t.cos(), r * t.sin());
                let from = DVec3::new(300.0, 0.0, 0.0);
                Setup { triangles: hemisphere(), frustum: frustum(from, 80.0, 100.0 * v, 80.0 * focus) }
            }
            Shape::Tube => {
                let v = across(random);
                let radius = 100.0 * focus;
                Setup { triangles: tube(v), frustum: frustum(-250.0 * v, radius, 250.0 * v, radius) }
            }
        }
    }
}

/// A direction with components uniform in 0..1, normalised.
fn direction(random: &mut Random) -> DVec3 {
    loop {
        let v = DVec3::new(random.uniform(), random.uniform(), random.uniform());
        if v.length() > 1e-3 {
            return v.normalize();
        }
    }
}

/// (0, y, z), uniform in -1..1, not normalised. All but null vectors, which have no direction.
fn across(random: &mut Random) -> DVec3 {
    loop {
        let v = DVec3::new(0.0, random.signed(), random.signed());
        if v.length() > 1e-3 {
            return v;
        }
    }
}

/// Half a sphere of radius 100 around the origin, towards `pole`: ring k has 6 (k + 1) points at
/// height 1 - ((k + 1) / rings)² of the radius, the last one on the equator. As in the author's
/// program, a ring's points begin at v1 and go towards v2, where v2 = normalised(y × pole) and v1 =
/// normalised(v2 × pole).
fn dome(rings: usize, pole: Vec3) -> Vec<Triangle> {
    let v2 = Vec3::Y.cross(pole).normalize();
    let v1 = v2.cross(pole).normalize();
    let ring = |k: usize| -> Vec<Vec3> {
        let height = 1.0 - ((k + 1) as f64 / rings as f64).powi(2);
        let radius = (1.0 - height * height).sqrt();
        let points = 6 * (k + 1);
        let point = |index| {
            let (sin, cos) = (TAU * index as f64 / points as f64).sin_cos();
            100.0 * (height as f32 * pole + (radius * cos) as f32 * v1 + (radius * sin) as f32 * v2)
        };
        (0..points).map(point).collect()
    };
    let mut triangles = Vec::new();
    let mut inner = vec![100.0 * pole];
    for k in 0..rings {
        let outer = ring(k);
        // Both rings are walked around together, by one sixth at a time: k points of the inner against k + 1.
        for sector in 0..6 {
            let at_inner = |step: usize| inner[(sector * k + step) % inner.len()];
            let at_outer = |step: usize| outer[(sector * (k + 1) + step) % outer.len()];
            for step in 0..=k {
                triangles.push(Triangle([at_inner(step), at_outer(step), at_outer(step + 1)]));
                if step < k {
                    triangles.push(Triangle([at_inner(step), at_outer(step + 1), at_inner(step + 1)]));
                }
            }
        }
        inner = outer;
    }
    triangles
}

/// 1728 triangles: a dome of 12 rings towards z, and the same mirrored in the centre.
pub fn sphere() -> Vec<Triangle> {
    let half = dome(12, Vec3::Z);
    let mirrored = half.iter().map(|triangle| Triangle(triangle.0.map(|corner| -corner))).collect();
    [half, mirrored].concat()
}

/// 1734 triangles: a dome of 17 rings, towards -x.
pub fn hemisphere() -> Vec<Triangle> {
    dome(17, Vec3::NEG_X)
}

/// 1682 triangles: 29 × 29 cells of a square of 400 at x = 0, centred.
pub fn plane() -> Vec<Triangle> {
    grid(29, 29, |row, column| {
        let at = |index: usize| (400.0 * index as f64 / 29.0 - 200.0) as f32;
        Vec3::new(0.0, at(row), at(column))
    })
}

/// 1702 triangles: 23 cells along `axis`, from -200 to 200 times it, and 37 around, at radius 100. The ends are open.
///
/// As in the author's program, the points around begin at u = normalised(axis × (1.3, 23.4, 12.2)),
/// a direction that stands for none in particular, and go towards v = normalised(u × axis).
pub fn tube(axis: DVec3) -> Vec<Triangle> {
    let u = axis.cross(DVec3::new(1.3, 23.4, 12.2)).normalize();
    let v = u.cross(axis).normalize();
    grid(23, 37, |along, around| {
        let height = 400.0 * along as f64 / 23.0 - 200.0;
        let (sin, cos) = (TAU * (around % 37) as f64 / 37.0).sin_cos();
        (height * axis + 100.0 * (cos * u + sin * v)).as_vec3()
    })
}

/// Two triangles for each of `rows` × `columns` cells between the points `at(row, column)`.
fn grid(rows: usize, columns: usize, at: impl Fn(usize, usize) -> Vec3) -> Vec<Triangle> {
    let cell = |index: usize| {
        let (row, column) = (index / columns, index % columns);
        let [a, b] = [at(row, column), at(row, column + 1)];
        let [c, d] = [at(row + 1, column), at(row + 1, column + 1)];
        [Triangle([a, b, c]), Triangle([d, c, b])]
    };
    (0..rows * columns).flat_map(cell).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    /// Edges that only one triangle has.
    fn border(triangles: &[Triangle]) -> usize {
        let key = |p: Vec3| [p.x, p.y, p.z].map(|c| (f64::from(c) * 100.0).round() as i64);
        let mut edges: HashMap<_, usize> = HashMap::new();
        for Triangle([a, b, c]) in triangles {
            for (a, b) in [(a, b), (b, c), (c, a)] {
                let (a, b) = (key(*a), key(*b));
                *edges.entry((a.min(b), a.max(b))).or_default() += 1;
            }
        }
        assert!(edges.values().all(|&count| count <= 2), "an edge has three triangles");
        edges.values().filter(|&&count| count == 1).count()
    }

    #[test]
    fn shapes_have_the_papers_triangles_and_no_holes() {
        let tube = tube(DVec3::new(0.0, 0.6, -0.3));
        for (triangles, count, open) in
            [(sphere(), 1728, 0), (plane(), 1682, 4 * 29), (hemisphere(), 1734, 6 * 17), (tube, 1702, 2 * 37)]
        {
            assert_eq!(triangles.len(), count);
            assert_eq!(border(&triangles), open);
            assert!(triangles.iter().all(|t| t.scaled_normal().length() > 1.0));
        }
    }

    #[test]
    fn round_shapes_are_round() {
        for Triangle(corners) in [sphere(), hemisphere()].concat() {
            assert!(corners.iter().all(|p| (p.length() - 100.0).abs() < 1e-3));
        }
        assert!(hemisphere().iter().all(|t| t.bounds().upper.x < 1e-3));
    }

    /// Worked out by hand from the author's vectors.
    #[test]
    fn points_begin_where_the_authors_do() {
        // Towards -x: v2 = z and v1 = -y; the first ring is at height 1 - 1/17².
        let first = hemisphere()[0].0[1];
        assert!((first - Vec3::new(-99.653_98, -8.311_69, 0.0)).length() < 1e-3, "{first}");
        // Along y: u = normalised(12.2, 0, -1.3), v = normalised(u × y) = normalised(1.3, 0, 12.2).
        let [first, second, _] = tube(DVec3::Y)[0].0;
        assert!((first - Vec3::new(99.437_07, -200.0, -10.595_75)).length() < 1e-3, "{first}");
        let turned = Vec3::new(99.797_44, -200.0, 6.361_6);
        assert!((second - turned).length() < 1e-3, "{second}");
        let (near, far) = (&sphere()[..864], &sphere()[864..]);
        assert!(near.iter().zip(far).all(|(a, b)| a.0.map(|corner| -corner) == b.0));
    }

    #[test]
    fn frusta_are_where_the_paper_puts_them() {
        let mut random = Random::new(5);
        let setup = Setup::new(Shape::Plane, 0.5, &mut random);
        assert_eq!(setup.frustum.to.x, 0.0);
        assert_eq!(setup.frustum.from - setup.frustum.to, DVec3::new(300.0, 0.0, 0.0));
        for ray in setup.frustum.rays(100, &mut random) {
            assert!((ray.origin.as_dvec3() - setup.frustum.from).length() <= 80.001);
            assert!((ray.at(1.0).as_dvec3() - setup.frustum.to).length() <= 40.001);
        }
        for focus in [0.0, 1.0] {
            let setup = Setup::new(Shape::Tube, focus, &mut random);
            let axis = setup.frustum.to - setup.frustum.from;
            assert!(setup.triangles.iter().all(|t| t.bounds().lower.x >= -100.001));
            assert!(axis.x == 0.0 && setup.frustum.from_radius == 100.0 * focus);
        }
    }
}
