//! What the tests of traversal, replay and comparison share: scenes, random trees, rays, and truth by brute force in
//! double precision, written without a look at the code under test.
#![allow(dead_code)] // Each test binary uses its part.

pub mod cli;
pub mod files;

use embree_trace::geometry::{Aabb, DVec3, Ray, Triangle, Vec3};
use embree_trace::tree::{Node, Tree};

/// xorshift64*: enough for tests, the same everywhere.
pub struct Random(pub u64);

impl Random {
    pub fn bits(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    pub fn below(&mut self, end: usize) -> usize {
        (self.bits() % end as u64) as usize
    }

    /// -1 to 1.
    pub fn signed(&mut self) -> f32 {
        (self.bits() >> 40) as f32 / (1 << 23) as f32 - 1.0
    }

    pub fn vector(&mut self) -> Vec3 {
        Vec3::new(self.signed(), self.signed(), self.signed())
    }
}

/// `count` small triangles in the unit cube around the origin.
pub fn soup(count: usize, size: f32, random: &mut Random) -> Vec<Triangle> {
    (0..count)
        .map(|_| {
            let corner = random.vector();
            Triangle([corner, corner + size * random.vector(), corner + size * random.vector()])
        })
        .collect()
}

/// A height field over [-1, 1]², neighbours sharing edges: `n` × `n` cells.
pub fn height_field(n: usize, height: f32, random: &mut Random) -> Vec<Triangle> {
    let heights: Vec<f32> = (0..(n + 1) * (n + 1)).map(|_| height * random.signed()).collect();
    let at = |x: usize, y: usize| {
        let scale = |i: usize| 2.0 * i as f32 / n as f32 - 1.0;
        Vec3::new(scale(x), heights[y * (n + 1) + x], scale(y))
    };
    (0..n * n)
        .flat_map(|cell| {
            let (x, y) = (cell % n, cell / n);
            let [a, b, c, d] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
            [Triangle([a, b, d]), Triangle([c, d, b])]
        })
        .collect()
}

/// Long thin triangles across the unit cube.
pub fn slivers(count: usize, random: &mut Random) -> Vec<Triangle> {
    (0..count)
        .map(|_| {
            let (a, b) = (random.vector(), random.vector());
            Triangle([a, b, a + 1e-3 * random.vector()])
        })
        .collect()
}

/// Every triangle of `of` twice, the copies in another order.
pub fn coincident(of: &[Triangle]) -> Vec<Triangle> {
    of.iter().chain(of.iter().rev()).copied().collect()
}

/// The scenes that every tree is tried on, by name.
pub fn scenes() -> Vec<(&'static str, Vec<Triangle>)> {
    let random = &mut Random(42);
    let cells = height_field(9, 0.2, random);
    vec![
        ("soup", soup(300, 0.3, random)),
        ("height field", height_field(12, 0.1, random)),
        ("flat plane", height_field(8, 0.0, random)),
        ("slivers", slivers(150, random)),
        ("coincident", coincident(&cells)),
        ("far away", soup(200, 0.3, random).iter().map(|t| Triangle(t.0.map(|v| v + 1000.0))).collect()),
        ("one", soup(1, 1.0, random)),
        ("none", Vec::new()),
    ]
}

/// A tree with random splits: `width` children at most, leaves of `max_leaf` at most. A node has 2 children when `width` is 2.
pub fn random_tree(triangles: &[Triangle], width: usize, max_leaf: usize, random: &mut Random) -> Tree {
    let bounds = |list: &[u32]| {
        list.iter().fold(Aabb::EMPTY, |all, &index| all.union(&triangles[index as usize].bounds()))
    };
    let mut tree = Tree::default();
    let all: Vec<u32> = (0..triangles.len() as u32).collect();
    let mut lists = vec![all];
    let mut next = 0;
    // Nodes in the order of `lists`: children are appended behind all that is known, so they are adjacent and later.
    while next < lists.len() {
        let mut list = std::mem::take(&mut lists[next]);
        next += 1;
        let few = list.len() <= max_leaf && random.below(3) > 0;
        if list.len() <= 1 || few {
            tree.nodes.push(Node::leaf(bounds(&list), tree.primitives.len() as u32, list.len() as u32));
            tree.primitives.extend(list);
            continue;
        }
        let children = if width == 2 { 2 } else { 2 + random.below(width - 1) }.min(list.len());
        tree.nodes.push(Node::inner(bounds(&list), lists.len() as u32, children as u32));
        // Mostly split in space, sometimes at random, so that siblings overlap.
        if random.below(4) > 0 {
            let axis = random.below(3);
            let key = |index: &u32| triangles[*index as usize].centroid()[axis];
            list.sort_by(|a, b| key(a).total_cmp(&key(b)));
        } else {
            for i in (1..list.len()).rev() {
                list.swap(i, random.below(i + 1));
            }
        }
        let mut cuts: Vec<usize> = (0..children - 1).map(|_| 1 + random.below(list.len() - 1)).collect();
        cuts.sort();
        cuts.dedup();
        // Cuts that fell together: cut one element off the front of what is left.
        while cuts.len() < children - 1 {
            let free = (1..list.len()).find(|cut| !cuts.contains(cut)).expect("fewer children than elements");
            cuts.push(free);
            cuts.sort();
        }
        cuts.insert(0, 0);
        cuts.push(list.len());
        lists.extend(cuts.windows(2).map(|w| list[w[0]..w[1]].to_vec()));
    }
    tree
}

/// Rays that look for trouble around a scene in `around`: random ones, axis-parallel ones, ones in planes, along edges and through vertices.
pub fn rays(triangles: &[Triangle], count: usize, random: &mut Random) -> Vec<Ray> {
    let around = triangles.iter().fold(Aabb::EMPTY, |all, t| all.union(&t.bounds()));
    let around = if around.is_empty() { Aabb { lower: -Vec3::ONE, upper: Vec3::ONE } } else { around };
    let radius = 0.5 * around.extent().max_element().max(1.0);
    (0..count)
        .map(|i| {
            let mut origin = around.center() + 2.0 * radius * random.vector();
            let mut target = around.center() + radius * random.vector();
            let some = triangles.get(random.below(triangles.len().max(1)));
            if let (true, Some(t)) = (i % 3 == 0, some) {
                target = t.0[0].lerp(t.0[1], 0.3).lerp(t.0[2], 0.2);
            }
            let mut direction = target - origin;
            match i % 8 {
                1 => direction = Vec3::AXES[random.below(3)] * if i % 16 == 1 { 1.0 } else { -2.0 },
                2 => direction[random.below(3)] = 0.0,
                3 => {
                    if let Some(t) = some {
                        // Exactly through a vertex, along an axis: edges and box faces meet there.
                        let axis = random.below(3);
                        origin = t.0[random.below(3)];
                        origin[axis] -= radius;
                        direction = Vec3::AXES[axis];
                    }
                }
                4 => {
                    if let Some(t) = some {
                        // From a surface, as bounces are.
                        origin = t.centroid();
                        direction = random.vector();
                    }
                }
                _ => {}
            }
            let tnear = if i % 5 == 0 { 0.25 } else { 0.0 };
            let tfar = [f32::INFINITY, f32::MAX, 1.0, 0.7][random.below(4)];
            Ray { origin, tnear, direction, tfar }
        })
        .collect()
}

/// Rays that no renderer should send.
pub fn hostile_rays(random: &mut Random) -> Vec<Ray> {
    let odd =
        [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 0.0, -0.0, 1e-42, -1e-42, 3e38, -3e38, 1e-30, 1.0, -1.0];
    (0..800)
        .map(|i| {
            let mut pick =
                |usual: f32| if random.below(3) == 0 { odd[random.below(odd.len())] } else { usual };
            let origin = Vec3::new(pick(0.1), pick(-2.0), pick(0.3));
            let direction = Vec3::new(pick(0.1), pick(1.0), pick(-0.2));
            let (tnear, tfar) = if i % 2 == 0 { (0.0, f32::INFINITY) } else { (pick(0.0), pick(5.0)) };
            Ray { origin, tnear, direction, tfar }
        })
        .collect()
}

/// What double precision says of a ray and a triangle.
#[derive(Clone, Copy, Debug)]
pub struct Exact {
    pub t: f64,
    /// The least barycentric coordinate: negative outside, near zero on an edge.
    pub margin: f64,
    /// |cosine| between the ray and the plane's normal, which also is tiny for triangles without area.
    pub cosine: f64,
}

/// Plane first, then areas: not the test that traversal uses.
pub fn exact(ray: &Ray, triangle: &Triangle) -> Option<Exact> {
    let [a, b, c] = triangle.0.map(|v| v.as_dvec3());
    let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
    let n = (b - a).cross(c - a);
    let along = n.dot(d);
    if along == 0.0 || !along.is_finite() {
        return None;
    }
    let t = n.dot(a - o) / along;
    let p = o + t * d;
    let area = |x: DVec3, y: DVec3| (x - p).cross(y - p).dot(n) / n.length_squared();
    let margin = area(b, c).min(area(c, a)).min(area(a, b));
    Some(Exact { t, margin, cosine: along.abs() / (n.length() * d.length()) })
}

/// Where the closest certain hit lies at the latest, and the closest hit that could be one: grazing edges, planes or the interval's ends.
pub struct Truth {
    pub certain: f64,
    pub possible: Vec<(u32, f64)>,
}

/// A loop over all triangles.
pub fn truth(ray: &Ray, triangles: &[Triangle], accepts: impl Fn(u32) -> bool) -> Truth {
    let mut truth = Truth { certain: f64::INFINITY, possible: Vec::new() };
    let (tnear, tfar) = (f64::from(ray.tnear), f64::from(ray.tfar));
    for (index, triangle) in triangles.iter().enumerate() {
        let Some(hit) = exact(ray, triangle) else {
            // Edge-on to the last bit: rounding may turn it either way.
            truth.possible.push((index as u32, f64::NAN));
            continue;
        };
        let scale = triangle
            .0
            .iter()
            .chain([&ray.origin])
            .map(|v| f64::from(v.abs().max_element()))
            .fold(0.0, f64::max);
        let edge = triangle.0[1].distance(triangle.0[2]).min(triangle.0[0].distance(triangle.0[1]));
        let slack = 1e-5 + 1e-6 * scale / f64::from(edge).max(1e-9) / hit.cosine.max(1e-9);
        // What rounding does to the distance from the plane moves t by as much more as the ray is slanted.
        let end =
            1e-5 * hit.t.abs() + 1e-6 * scale / f64::from(ray.direction.length()) / hit.cosine.max(1e-9);
        if !accepts(index as u32) || hit.margin < -slack || hit.t < tnear - end || hit.t > tfar + end {
            continue;
        }
        truth.possible.push((index as u32, hit.t));
        if hit.margin > slack && hit.cosine > 1e-4 && hit.t > tnear + end && hit.t < tfar - end {
            truth.certain = truth.certain.min(hit.t + end);
        }
    }
    truth
}
