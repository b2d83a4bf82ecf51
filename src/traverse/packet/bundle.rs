//! The rays of a packet, eight side by side, and their tests against one box and one triangle.
//!
//! The operations, and their order, are those of one ray ([`PreparedRay::entry`], [`super::super::triangle`]): every lane has the bits that its
//! ray would have alone. Rays that run the same way along each axis share a packet, so that all have the same near faces of a box.

use super::super::Hit;
use super::super::form::Faces;
use super::super::leaf::Best;
use super::super::ray::PreparedRay;
use super::super::ray::{INVERTIBLE, MAGNIFIED_BELOW, MAGNIFIER, PADDING};
use super::super::simd::{Eight, Halves, LaneMask};
use super::descend::next;
use super::frustum::Frustum;
use crate::format::rays::NO_TRIANGLE;
use crate::geometry::{Ray, Triangle, Vec3};

/// Rays in an octet.
pub(super) const LANES: usize = 8;
/// Octets in a packet at most: sets of them are bits of a `u32`.
pub(super) const OCTETS: usize = 32;

/// Eight rays. A lane without a ray has an interval that fails every test.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Octet {
    /// By axis and lane, like the next three.
    pub origin: [[f32; LANES]; 3],
    pub near_inverse: [[f32; LANES]; 3],
    pub far_inverse: [[f32; LANES]; 3],
    direction: [[f32; LANES]; 3],
    pub tnear: [f32; LANES],
    /// See [`PreparedRay::magnified`], and `tnear` times that.
    magnified: [f32; LANES],
    near: [f32; LANES],
    pub tfar: [f32; LANES],
    /// Boxes entered behind this need not be visited: the best hit so far, or `tfar`; -inf for a ray that needs no more answer.
    end: [f32; LANES],
    /// See [`Best`].
    bound: [f32; LANES],
    t: [f32; LANES],
    triangle: [u32; LANES],
}

impl Octet {
    const EMPTY: Octet = Octet {
        origin: [[0.0; LANES]; 3],
        near_inverse: [[1.0; LANES]; 3],
        far_inverse: [[1.0; LANES]; 3],
        direction: [[0.0; LANES]; 3],
        tnear: [f32::INFINITY; LANES],
        magnified: [1.0; LANES],
        near: [f32::INFINITY; LANES],
        tfar: [f32::NEG_INFINITY; LANES],
        end: [f32::NEG_INFINITY; LANES],
        bound: [f32::NEG_INFINITY; LANES],
        t: [f32::INFINITY; LANES],
        triangle: [NO_TRIANGLE; LANES],
    };

    /// Makes eight rays ready, as [`PreparedRay::new`] does each.
    #[inline(always)]
    fn prepare<V: Eight>(&mut self, rays: &[[f32; 8]; 8]) -> Ways {
        let [x, y, z, tnear, dx, dy, dz, tfar] = V::columns(rays);
        let zero = V::splat(0.0);
        let absolute = |v: V| v.flip(v.signs());
        // What is not finite gives NaN.
        let odd = [x, y, z, dx, dy, dz].into_iter().fold(zero, |sum, v| v.mul_add(zero, sum));
        let able = odd.le(zero).and(tnear.le(tfar));
        let tnear = V::select(able, tnear.max_or(V::splat(f32::MIN)), V::splat(f32::INFINITY));
        let tfar = V::select(able, tfar.min_or(V::splat(f32::MAX)), V::splat(f32::NEG_INFINITY));
        let not_negative = zero.le(tnear);
        let mut downwards = [0; 3];
        for (axis, (o, d)) in [(x, dx), (y, dy), (z, dz)].into_iter().enumerate() {
            let size = absolute(d);
            let (least, most) = (V::splat(*INVERTIBLE.start()), V::splat(*INVERTIBLE.end()));
            let nan = V::splat(f32::NAN);
            let inverse = V::splat(1.0).div(d);
            let inverse = V::select(
                not_negative,
                V::select(size.le(zero), inverse, V::select(least.le(size).and(size.le(most)), inverse, nan)),
                nan,
            );
            downwards[axis] = inverse.lt(zero).bits();
            o.store(&mut self.origin[axis]);
            d.store(&mut self.direction[axis]);
            inverse.store(&mut self.near_inverse[axis]);
            inverse.mul(V::splat(1.0 + PADDING)).store(&mut self.far_inverse[axis]);
        }
        let small = absolute(tnear).lt(V::splat(MAGNIFIED_BELOW));
        let magnified = V::select(small, V::splat(MAGNIFIER), V::splat(1.0));
        magnified.store(&mut self.magnified);
        tnear.mul(magnified).store(&mut self.near);
        tnear.store(&mut self.tnear);
        [&mut self.tfar, &mut self.end, &mut self.bound].into_iter().for_each(|end| tfar.store(end));
        self.triangle = [NO_TRIANGLE; LANES];
        Ways { able: able.bits(), downwards }
    }

    /// Takes a ray from a lane of another octet.
    #[inline(always)]
    fn copy(&mut self, lane: usize, other: &Octet, from: usize) {
        for axis in 0..3 {
            self.origin[axis][lane] = other.origin[axis][from];
            self.near_inverse[axis][lane] = other.near_inverse[axis][from];
            self.far_inverse[axis][lane] = other.far_inverse[axis][from];
            self.direction[axis][lane] = other.direction[axis][from];
        }
        self.tnear[lane] = other.tnear[from];
        (self.magnified[lane], self.near[lane]) = (other.magnified[from], other.near[from]);
        self.tfar[lane] = other.tfar[from];
        self.answer_as(lane, other, from);
    }

    /// Takes what is known of an answer from a lane of another octet.
    #[inline(always)]
    fn answer_as(&mut self, lane: usize, other: &Octet, from: usize) {
        (self.end[lane], self.bound[lane]) = (other.end[from], other.bound[from]);
        (self.t[lane], self.triangle[lane]) = (other.t[from], other.triangle[from]);
    }

    /// Which rays enter a box no later than at their ends, and where.
    #[inline(always)]
    pub fn enter<V: Eight>(&self, faces: &Faces) -> (V::Mask, V) {
        let (mut entry, mut exit) = (V::load(&self.tnear), V::load(&self.end));
        for axis in 0..3 {
            let origin = V::load(&self.origin[axis]);
            let near = V::splat(faces.near[axis]).sub(origin).mul(V::load(&self.near_inverse[axis]));
            let far = V::splat(faces.far[axis]).sub(origin).mul(V::load(&self.far_inverse[axis]));
            entry = near.max_or(entry);
            exit = far.min_or(exit);
        }
        (entry.le(exit), entry)
    }

    /// Which rays hit a triangle, as bits, and at which t.
    #[inline(always)]
    pub fn hits<V: Eight>(&self, triangle: &Splat<V>, near_face: &[usize; 3]) -> (u32, [f32; LANES]) {
        let zero = V::splat(0.0);
        let load = |rows: &[[f32; LANES]; 3]| [V::load(&rows[0]), V::load(&rows[1]), V::load(&rows[2])];
        let (origin, direction) = (load(&self.origin), load(&self.direction));
        let c = difference(triangle.vertices[0], origin);
        let r = cross(c, direction);
        let den = dot(triangle.normal, direction);
        let sign = den.signs();
        let den_abs = den.flip(sign);
        let u = dot(r, triangle.edge2).flip(sign);
        let v = dot(r, triangle.edge1).flip(sign);
        let t = dot(triangle.normal, c).flip(sign);
        // A denominator of zero fails one of the last two.
        let inside = zero.le(u).and(zero.le(v)).and(u.add(v).le(den_abs));
        let behind_start = den_abs.mul(V::load(&self.near)).lt(t.mul(V::load(&self.magnified)));
        let within = behind_start.and(t.le(den_abs.mul(V::load(&self.bound))));
        let mask = inside.and(within).bits();
        if mask == 0 {
            return (0, [0.0; LANES]);
        }
        let (confirmed, t) = self.confirm(triangle, near_face, t.div(den_abs));
        (mask & confirmed, t.to_array())
    }

    /// The part that few candidates reach: agreement with the triangle's box.
    #[inline(always)]
    fn confirm<V: Eight>(&self, triangle: &Splat<V>, near_face: &[usize; 3], t: V) -> (u32, V) {
        let [v0, v1, v2] = triangle.vertices;
        let (mut entry, mut exit) = (V::load(&self.tnear), V::load(&self.tfar));
        for axis in 0..3 {
            let lower = v0[axis].min_or(v1[axis]).min_or(v2[axis]);
            let upper = v0[axis].max_or(v1[axis]).max_or(v2[axis]);
            let (near, far) = if near_face[axis] == 1 { (upper, lower) } else { (lower, upper) };
            let origin = V::load(&self.origin[axis]);
            entry = near.sub(origin).mul(V::load(&self.near_inverse[axis])).max_or(entry);
            exit = far.sub(origin).mul(V::load(&self.far_inverse[axis])).min_or(exit);
        }
        let t = t.max_or(entry);
        let finite = t.le(V::splat(f32::MAX)).and(V::splat(f32::MIN).le(t));
        (entry.le(exit).and(finite).bits(), t.min_or(V::load(&self.tfar)))
    }

    /// A ray on its own.
    #[inline(always)]
    pub fn ray(&self, lane: usize) -> PreparedRay {
        let vector = |rows: &[[f32; LANES]; 3]| Vec3::new(rows[0][lane], rows[1][lane], rows[2][lane]);
        PreparedRay {
            origin: vector(&self.origin),
            direction: vector(&self.direction),
            tnear: self.tnear[lane],
            tfar: self.tfar[lane],
            near_inverse: vector(&self.near_inverse),
            magnified: self.magnified[lane],
            far_inverse: vector(&self.far_inverse),
            unused: 0.0,
        }
    }

    /// What is known of a ray's answer.
    #[inline(always)]
    pub fn best(&self, lane: usize) -> Best {
        Best { t: self.end[lane], triangle: self.triangle[lane], bound: self.bound[lane] }
    }

    /// Keeps a hit. With `ANY` the ray needs no other.
    #[inline(always)]
    pub fn keep<const ANY: bool>(&mut self, lane: usize, best: &Best) {
        (self.t[lane], self.triangle[lane]) = (best.t, best.triangle);
        (self.end[lane], self.bound[lane]) =
            if ANY { (f32::NEG_INFINITY, f32::NEG_INFINITY) } else { (best.t, best.bound) };
    }

    fn answer(&self, lane: usize) -> Option<Hit> {
        (self.triangle[lane] != NO_TRIANGLE).then_some(Hit { t: self.t[lane], triangle: self.triangle[lane] })
    }
}

/// A triangle as octets are tested against it: the same in every lane.
pub(super) struct Splat<V> {
    vertices: [[V; 3]; 3],
    edge1: [V; 3],
    edge2: [V; 3],
    normal: [V; 3],
}

impl<V: Eight> Splat<V> {
    #[inline(always)]
    pub fn new(triangle: &Triangle) -> Splat<V> {
        let splat = |vertex: Vec3| [V::splat(vertex.x), V::splat(vertex.y), V::splat(vertex.z)];
        let [v0, v1, v2] = [splat(triangle.0[0]), splat(triangle.0[1]), splat(triangle.0[2])];
        let vertices = [v0, v1, v2];
        let (edge1, edge2) = (difference(v0, v1), difference(v2, v0));
        Splat { vertices, edge1, edge2, normal: cross(edge2, edge1) }
    }
}

#[inline(always)]
fn difference<V: Eight>(a: [V; 3], b: [V; 3]) -> [V; 3] {
    std::array::from_fn(|axis| a[axis].sub(b[axis]))
}

#[inline(always)]
fn cross<V: Eight>(a: [V; 3], b: [V; 3]) -> [V; 3] {
    let minus = V::splat(-0.0);
    let minor = |a1: V, b2: V, a2: V, b1: V| a1.mul_add(b2, a2.mul(b1).flip(minus));
    [minor(a[1], b[2], a[2], b[1]), minor(a[2], b[0], a[0], b[2]), minor(a[0], b[1], a[1], b[0])]
}

#[inline(always)]
fn dot<V: Eight>(a: [V; 3], b: [V; 3]) -> V {
    a[0].mul_add(b[0], a[1].mul_add(b[1], a[2].mul(b[2])))
}

/// Which way the rays of an octet run: bits by lane.
#[derive(Clone, Copy, Debug, Default)]
struct Ways {
    /// Rays that can hit something.
    able: u32,
    /// By axis: see [`PreparedRay::downwards`].
    downwards: [u32; 3],
}

impl Ways {
    /// The able rays that run the way of number `way`: bit i is set for downwards on axis i.
    fn of(&self, way: usize) -> u32 {
        let same =
            |axis: usize| if way >> axis & 1 == 1 { self.downwards[axis] } else { !self.downwards[axis] };
        self.able & same(0) & same(1) & same(2)
    }
}

/// Rays that run the same way along each axis.
#[derive(Debug)]
pub(super) struct Bundle {
    pub octets: Vec<Octet>,
    /// Number of the query of each lane.
    pub queries: Vec<u32>,
    /// Where each lane's ray was before it was regrouped, lane by lane.
    pub places: Vec<u32>,
    pub near_face: [usize; 3],
    /// Of all rays; without use when [`Self::bound`] found them to be few.
    pub frustum: Frustum,
    /// Where the last ray ended when that was computed last, and how many hits were kept since.
    end: f32,
    pub hits: usize,
}

impl Default for Bundle {
    fn default() -> Bundle {
        Bundle {
            octets: vec![Octet::EMPTY; OCTETS],
            queries: Vec::with_capacity(OCTETS * LANES),
            places: Vec::new(),
            near_face: [0; 3],
            frustum: Frustum::new::<Halves>(&[]),
            end: f32::INFINITY,
            hits: 0,
        }
    }
}

impl Bundle {
    #[inline(always)]
    pub fn clear(&mut self, near_face: [usize; 3]) {
        self.queries.clear();
        self.places.clear();
        self.near_face = near_face;
    }

    /// Takes a ray from a lane of an octet, with its query's number.
    #[inline(always)]
    pub fn push(&mut self, from: &Octet, lane: usize, query: u32) {
        let place = self.queries.len();
        let octet = &mut self.octets[place / LANES];
        if place.is_multiple_of(LANES) {
            *octet = Octet::EMPTY;
        }
        octet.copy(place % LANES, from, lane);
        self.queries.push(query);
    }

    /// Computes the frustum of so many octets or more.
    #[inline(always)]
    pub fn bound<V: Eight>(&mut self, least: u32) {
        let count = self.queries.len().div_ceil(LANES);
        if count >= least as usize {
            self.frustum = Frustum::new::<V>(&self.octets[..count]);
            self.hits = self.queries.len();
        }
    }

    /// All octets in use, as bits.
    #[inline(always)]
    pub fn all(&self) -> u32 {
        u32::MAX >> (OCTETS - self.queries.len().div_ceil(LANES))
    }

    /// The queries of an octet's rays.
    #[inline(always)]
    pub fn queries_of(&self, octet: usize) -> &[u32] {
        &self.queries[octet * LANES..self.queries.len().min((octet + 1) * LANES)]
    }

    /// Where the last ray ends, or later: not computed anew for every hit.
    #[inline(always)]
    pub fn end<V: Eight>(&mut self) -> f32 {
        if self.hits * 8 >= self.queries.len() {
            self.hits = 0;
            let minus = V::splat(-0.0);
            let mut end = V::splat(f32::INFINITY);
            for octet in &self.octets[..self.queries.len().div_ceil(LANES)] {
                end = V::load(&octet.end).flip(minus).min_or(end);
            }
            self.end = -end.least();
        }
        self.end
    }

    /// Hands out the answers.
    #[inline(always)]
    pub fn answer(&self, answers: &mut [Option<Hit>]) {
        for (queries, octet) in self.queries.chunks(LANES).zip(&self.octets) {
            for (lane, &query) in queries.iter().enumerate() {
                answers[query as usize] = octet.answer(lane);
            }
        }
    }
}

/// The rays of a packet, and those of them that were regrouped, again and again.
#[derive(Debug)]
pub(super) struct Bundles {
    bundles: Vec<Bundle>,
    /// The one whose rays are followed now.
    current: usize,
    /// All rays as they came, and which way they run.
    prepared: Vec<Octet>,
    ways: Vec<Ways>,
    count: usize,
}

impl Default for Bundles {
    fn default() -> Bundles {
        Bundles {
            bundles: vec![Bundle::default()],
            current: 0,
            prepared: vec![Octet::EMPTY; OCTETS],
            ways: Vec::with_capacity(OCTETS),
            count: 0,
        }
    }
}

/// A ray that cannot hit anything.
const DEAD: [f32; 8] = [0.0, 0.0, 0.0, f32::INFINITY, 0.0, 0.0, 0.0, f32::NEG_INFINITY];

impl Bundles {
    /// Makes rays ready. Returns the set of ways that they run: bit i for way i, see [`Ways::of`].
    #[inline(always)]
    pub fn prepare<V: Eight>(&mut self, rays: &[Ray]) -> u32 {
        let (whole, rest) = bytemuck::cast_slice::<Ray, [f32; 8]>(rays).as_chunks::<LANES>();
        self.ways.clear();
        self.count = rays.len();
        for (rays, octet) in whole.iter().zip(&mut self.prepared) {
            self.ways.push(octet.prepare::<V>(rays));
        }
        if !rest.is_empty() {
            let mut rays = [DEAD; LANES];
            rays[..rest.len()].copy_from_slice(rest);
            self.ways.push(self.prepared[whole.len()].prepare::<V>(&rays));
        }
        (0..8).filter(|&way| self.ways.iter().any(|octet| octet.of(way) != 0)).map(|way| 1 << way).sum()
    }

    /// Begins with the rays that run this way; `only`: all that can hit anything do.
    #[inline(always)]
    pub fn take(&mut self, way: usize, only: bool) {
        self.current = 0;
        let first = &mut self.bundles[0];
        first.clear([way & 1, way >> 1 & 1, way >> 2]);
        if only {
            std::mem::swap(&mut first.octets, &mut self.prepared);
            first.queries.extend(0..self.count as u32);
            return;
        }
        for (number, (ways, from)) in self.ways.iter().zip(&self.prepared).enumerate() {
            let mut lanes = ways.of(way);
            while lanes != 0 {
                let lane = next::<LANES>(&mut lanes);
                first.push(from, lane, (number * LANES + lane) as u32);
            }
        }
    }

    /// The rays that are followed now.
    #[inline(always)]
    pub fn current(&mut self) -> &mut Bundle {
        &mut self.bundles[self.current]
    }

    /// The rays that were followed up to now, and room for those that are from now on.
    #[inline(always)]
    pub fn next(&mut self) -> (&Bundle, &mut Bundle) {
        self.current += 1;
        if self.bundles.len() == self.current {
            self.bundles.push(Bundle::default());
        }
        let (before, after) = self.bundles.split_at_mut(self.current);
        (&before[self.current - 1], &mut after[0])
    }

    /// Goes back to the rays before they were regrouped, with what was found since.
    #[inline(always)]
    pub fn put_back(&mut self) {
        let (before, after) = self.bundles.split_at_mut(self.current);
        self.current -= 1;
        let (to, from) = (&mut before[self.current], &after[0]);
        for (number, &place) in from.places.iter().enumerate() {
            let place = place as usize;
            to.octets[place / LANES].answer_as(place % LANES, &from.octets[number / LANES], number % LANES);
        }
    }
}
