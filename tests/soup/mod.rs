//! Triangles for tests: random ones, and every kind that breaks builders.

use embree_trace::geometry::{Triangle, Vec3};

/// SplitMix64 (Steele, Lea and Flood 2014).
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(seed)
    }

    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub fn below(&mut self, end: u64) -> u64 {
        self.next() % end
    }

    /// From 0 to 1.
    pub fn unit(&mut self) -> f32 {
        (self.next() >> 40) as f32 / (1u64 << 24) as f32
    }

    pub fn vector(&mut self) -> Vec3 {
        Vec3::new(self.unit(), self.unit(), self.unit())
    }
}

/// Triangles of a twentieth of the unit cube that they are spread over.
pub fn soup(count: usize, seed: u64) -> Vec<Triangle> {
    let mut random = Random::new(seed);
    (0..count)
        .map(|_| {
            let at = random.vector();
            Triangle([at, at + 0.05 * random.vector(), at + 0.05 * random.vector()])
        })
        .collect()
}

/// Several hundred sets of triangles, each with a name that says what is wrong with it.
pub fn degenerate() -> Vec<(String, Vec<Triangle>)> {
    let mut sets = Vec::new();
    let special = [
        0.0,
        -0.0,
        1.0,
        f32::MIN_POSITIVE,
        f32::from_bits(1),
        1e-30,
        1e30,
        1e38,
        -1e38,
        f32::MAX,
        f32::MIN,
        f32::EPSILON,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
    ];
    // Any mixture of special numbers, with and without those that are not finite.
    for seed in 0..200 {
        let mut random = Random::new(seed);
        let numbers = if seed % 2 == 0 { &special[..12] } else { &special[..] };
        let mut number = || numbers[random.below(numbers.len() as u64) as usize];
        let count = 1 + seed as usize % 50;
        let triangles =
            (0..count).map(|_| Triangle([0; 3].map(|_| Vec3::new(number(), number(), number())))).collect();
        sets.push((format!("special numbers, seed {seed}"), triangles));
    }
    // The same soup squeezed, moved and scaled.
    let usual = soup(300, 1);
    let mut changed = |name: String, change: &dyn Fn(Vec3) -> Vec3| {
        sets.push((name, usual.iter().map(|t| Triangle(t.0.map(change))).collect()));
    };
    for exponent in (-45..=38).step_by(4) {
        let scale = 10f64.powi(exponent);
        changed(format!("scaled by 1e{exponent}"), &|v| (v.as_dvec3() * scale).as_vec3());
        changed(format!("moved by 1e{exponent}"), &|v| v + Vec3::splat(scale as f32));
        changed(format!("x scaled by 1e{exponent}"), &|v| Vec3::new((v.x as f64 * scale) as f32, v.y, v.z));
    }
    for mask in 0..8u32 {
        let keep = |axis: u32, x: f32| if mask >> axis & 1 == 1 { x } else { 0.5 };
        changed(format!("flat, mask {mask}"), &|v| Vec3::new(keep(0, v.x), keep(1, v.y), keep(2, v.z)));
    }
    changed("on a coarse grid".into(), &|v| (v * 3.0).round());
    changed("all of space".into(), &|v| (v - 0.5) * 1.9 * f32::MAX);
    // Equal centroids, different boxes; equal boxes, different triangles; points and segments.
    for count in [2, 3, 4, 5, 8, 9, 33, 700] {
        let nested = (0..count).map(|i| {
            let corner = Vec3::splat(1.0 + i as f32);
            Triangle([-corner, corner, corner])
        });
        sets.push((format!("{count} nested"), nested.collect()));
        let same = Triangle([Vec3::ZERO, Vec3::ONE, Vec3::X]);
        sets.push((format!("{count} identical"), vec![same; count]));
        let points = (0..count).map(|i| Triangle([Vec3::splat((i % 3) as f32); 3]));
        sets.push((format!("{count} points"), points.collect()));
        // Centroids at powers of two: each split separates one.
        let spread = (0..count).map(|i| Triangle([Vec3::splat(2f32.powi(i as i32 % 250 - 126)); 3]));
        sets.push((format!("{count} at powers of two"), spread.collect()));
    }
    sets
}
