//! Tests that a scene is the same wherever it stands, however large it is, and from however far it
//! is seen: which share of the rays that leave its surfaces meets something is compared with brute
//! force in double precision at the origin.

use crate::embree::{EmbreeError, Isa, Scene, Settings};
use crate::format::rays::Purpose;
use crate::geometry::{DVec3, Ray, Vec3};
use crate::mesh::{Faces, Material, Mesh, Part};
use crate::progress::Progress;
use crate::random::Random;
use crate::render::job::{Job, tests::job};
use crate::render::meeting::Meeting;
use crate::render::queries::{Count, Counting, RayQueries, Tally, query};
use crate::render::scenery::{Scenery, Wishes};
use crate::render::shapes::{Met, Shapes};
use crate::render::surface::Surface;
use crate::render::testing::{BruteForce, cube, emitter, mesh, quad};
use crate::render::tiles::Tiles;
use crate::render::workers::{render, trace_tile};

/// Where a scene stands, and how large it is.
#[derive(Clone, Copy, Debug)]
struct Place {
    scale: f64,
    offset: DVec3,
}

const HOME: Place = Place { scale: 1.0, offset: DVec3::ZERO };
/// Metres east and north, as maps have them: floats are 1/32 and half a metre apart.
const UTM: Place = Place { scale: 1.0, offset: DVec3::new(500_000.0, 0.0, 5_700_000.0) };

impl Place {
    fn of(&self, point: Vec3) -> Vec3 {
        (point.as_dvec3() * self.scale + self.offset).as_vec3()
    }

    fn mesh(&self, mesh: &Mesh) -> Mesh {
        let vertices = mesh.vertices.iter().map(|vertex| self.of(*vertex)).collect();
        Mesh { vertices, ..mesh.clone() }
    }
}

/// A scene whose coordinates are multiples of a half, and a camera.
struct Stage {
    mesh: Mesh,
    eye: Vec3,
    target: Vec3,
    fov_degrees: f32,
}

/// The sides of a box.
fn block(corner: Vec3, size: Vec3) -> Vec<[Vec3; 4]> {
    cube(1.0).into_iter().map(|side| side.map(|vertex| corner + vertex * size)).collect()
}

/// A square of ground and nine towers, under the sky.
fn towers() -> Stage {
    let mut quads = vec![quad(Vec3::ZERO, Vec3::X * 200.0, Vec3::Z * 200.0)];
    for i in 0..9 {
        let corner = Vec3::new(40.0 + 50.0 * (i / 3) as f32, 0.0, 40.0 + 50.0 * (i % 3) as f32);
        quads.extend(block(corner, Vec3::new(10.0, 30.0, 10.0)));
    }
    let mesh = mesh(&[(&quads, Material::default())]);
    Stage {
        mesh,
        eye: Vec3::new(-60.0, 120.0, -60.0),
        target: Vec3::new(100.0, 0.0, 100.0),
        fov_degrees: 50.0,
    }
}

/// A hall with columns and a ramp that leans against nothing, lit by a lamp under its ceiling.
fn hall() -> Stage {
    let mut quads = block(Vec3::ZERO, Vec3::new(40.0, 12.0, 30.0));
    for i in 0..6 {
        let corner = Vec3::new(8.0 + 10.0 * (i / 2) as f32, 0.0, 8.0 + 12.0 * (i % 2) as f32);
        quads.extend(block(corner, Vec3::new(2.0, 9.0, 2.0)));
    }
    quads.push(quad(Vec3::new(14.0, 0.0, 11.0), Vec3::new(9.0, 3.0, 2.0), Vec3::new(-2.0, 1.0, 6.0)));
    let lamp = quad(Vec3::new(17.0, 11.5, 12.0), Vec3::X * 6.0, Vec3::Z * 6.0);
    let mesh = mesh(&[(&quads, Material::default()), (&[lamp], emitter(10.0, 0.0))]);
    Stage { mesh, eye: Vec3::new(2.0, 6.0, 2.0), target: Vec3::new(30.0, 4.0, 20.0), fov_degrees: 70.0 }
}

impl Stage {
    fn wishes(&self, place: &Place) -> Wishes {
        Wishes {
            eye_and_target: Some((place.of(self.eye), place.of(self.target))),
            fov_degrees: Some(self.fov_degrees),
            up: Some(Vec3::Y),
        }
    }

    /// The same view from `distance` away.
    fn seen_from_afar(mut self, distance: f64) -> Stage {
        let sight = (self.eye - self.target).as_dvec3();
        let half = sight.length() * libm::tan(f64::from(self.fov_degrees).to_radians() / 2.0);
        self.eye = (self.target.as_dvec3() + sight.normalize() * distance).as_vec3();
        self.fov_degrees = (2.0 * libm::atan(half / distance)).to_degrees() as f32;
        self
    }

    const JOB: fn() -> Job = || Job { width: 160, height: 120, samples: 8, max_depth: 2, packet: 4, ..job() };

    /// What Embree says of the scene at a place.
    fn traced(&self, place: &Place, settings: &Settings) -> Tally {
        let (mesh, job) = (place.mesh(&self.mesh), Stage::JOB());
        let scene = Scene::new(&mesh, settings).unwrap();
        let (triangles, mut queries) = (scene.triangles().0, scene.intersector().unwrap());
        let size = [job.width, job.height];
        let scenery = Scenery::new(&mesh, triangles, &mut queries, &self.wishes(place), size).unwrap();
        render(&scene, &scenery, &job, None, &Progress::hidden()).unwrap().tally
    }

    /// The truth: the scene at the origin, in double precision.
    fn known(&self) -> Tally {
        let (job, mut queries) = (Stage::JOB(), BruteForce::new(&self.mesh));
        let (triangles, size) = (self.mesh.triangles(), [job.width, job.height]);
        let scenery = Scenery::new(&self.mesh, triangles, &mut queries, &self.wishes(&HOME), size).unwrap();
        let mut counting = Counting { queries: &mut queries, tally: Tally::default() };
        let (tiles, mut pixels) = (Tiles::new(&job), Vec::new());
        for index in 0..tiles.len() {
            trace_tile(&scenery, &job, &tiles.tile(index), &mut counting, &mut pixels);
        }
        counting.tally
    }
}

/// How far two shares of hits are apart, relative to the second: of shadow rays, and of bounces.
fn apart(found: &Tally, known: &Tally) -> [f64; 2] {
    let share = |count: Count| {
        assert!(count.queries > 10_000 && count.hits > 500, "too few for a share: {count:?}");
        count.hits as f64 / count.queries as f64
    };
    let shadow = |tally: &Tally| share(tally.occlusion[Purpose::Shadow as usize]);
    let bounce = |tally: &Tally| share(tally.closest_hit[Purpose::Diffuse as usize]);
    [shadow(found) / shadow(known) - 1.0, bounce(found) / bounce(known) - 1.0]
}

/// Kernels that this processor has: with and without fused operations, of both kinds.
fn kernels() -> Vec<Settings> {
    let mut kernels = Vec::new();
    for isa in [Isa::Sse42, Isa::Avx2, Isa::Avx512] {
        for robust in [false, true] {
            let settings = Settings { isa: Some(isa), robust, ..Settings::default() };
            match Scene::new(&Mesh::default(), &settings) {
                Ok(_) => kernels.push(settings),
                Err(EmbreeError::UnsupportedIsa(_)) => {}
                Err(error) => panic!("{error}"),
            }
        }
    }
    kernels
}

/// Each kernel at each place against the truth.
fn same_shares(stage: &Stage, places: &[Place], tolerance: f64) {
    let (known, mut wrong) = (stage.known(), Vec::new());
    for place in places {
        for Settings { isa, robust, .. } in kernels() {
            let settings = Settings { isa, robust, ..Settings::default() };
            let apart = apart(&stage.traced(place, &settings), &known);
            let line = format!("{place:?} {isa:?}, robust {robust}: {apart:?}");
            println!("{line}");
            if apart.iter().any(|a| a.abs() >= tolerance) {
                wrong.push(line);
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

fn moved(x: f64, y: f64, z: f64) -> Place {
    Place { offset: DVec3::new(x, y, z), ..HOME }
}

#[test]
fn the_same_rays_hit_up_to_1000_km_from_the_origin() {
    let places =
        [HOME, moved(1e4, 0.0, -1e4), moved(1e5, 0.0, 0.0), moved(1e6, 0.0, 1e6), moved(-1e6, 1e6, 1e6)];
    for stage in [towers(), hall()] {
        same_shares(&stage, &places, 0.02);
    }
}

#[test]
fn the_same_rays_hit_where_floats_are_half_a_metre_apart() {
    for stage in [towers(), hall()] {
        same_shares(&stage, &[UTM], 0.05);
    }
}

#[test]
fn robust_kernels_are_used_where_floats_are_far_apart() {
    let (stage, default) = (towers(), Settings::default());
    let suited = |place: Place, mut settings: Settings| {
        let told = settings.suit(&place.mesh(&stage.mesh).vertices);
        assert_eq!(told.is_some(), settings.robust);
        settings.robust
    };
    assert!(!suited(HOME, default.clone()) && !suited(moved(1e6, 0.0, 1e6), default.clone()));
    assert!(suited(UTM, default.clone()));
    let named = Settings { tri_accel: Some("bvh4.triangle4".to_owned()), ..default };
    assert!(!suited(UTM, named));
}

#[test]
fn the_same_rays_hit_at_every_scale() {
    let places = [1e-3, 1.0 / 64.0, 1e2, 1e4].map(|scale| Place { scale, ..HOME });
    for stage in [towers(), hall()] {
        same_shares(&stage, &places, 0.02);
    }
}

#[test]
fn the_same_rays_hit_from_a_camera_far_away() {
    for distance in [1e4, 1e5, 1e6] {
        same_shares(&towers().seen_from_afar(distance), &[HOME], 0.02);
    }
}

/// A ray, and what it meets first.
fn first(queries: &mut impl RayQueries, origin: Vec3, direction: Vec3) -> (Ray, Option<Met>) {
    let ray = Ray { origin, tnear: 0.0, direction, tfar: f32::INFINITY };
    (ray, queries.closest_hit(&query(ray, 0, 0, Purpose::Unknown)))
}

/// Triangles of all shapes around a point, in a ball of radius `size`: two of three are slivers.
fn soup(random: &mut Random, place: DVec3, size: f64) -> Mesh {
    let mut vertices = Vec::new();
    for number in 0..2000 {
        let mut point = || DVec3::new(random.signed(), random.signed(), random.signed()) * size;
        let [a, b, c] = [point(), point(), point()];
        let thin = libm::exp10(-6.0 * random.uniform());
        let c = if number % 3 != 0 { a.lerp(b, random.uniform()) + c * thin } else { c };
        vertices.extend([a, b, c].map(|vertex| (vertex + place).as_vec3()));
    }
    let part = Part {
        name: String::new(),
        material: 0,
        faces: Faces::Triangles,
        indices: (0..vertices.len() as u32).collect(),
    };
    Mesh { vertices, parts: vec![part], materials: vec![Material::default()] }
}

/// A ray that leaves a triangle on one side never meets it again; what it starts above the triangle
/// is little.
#[test]
fn no_ray_meets_again_what_it_leaves() {
    let mut random = Random::new(17);
    let (mut asked, mut slivers, mut again) = (0u32, 0u32, 0u32);
    for settings in kernels() {
        for (place, size) in [
            (DVec3::ZERO, 1e-3),
            (DVec3::ZERO, 1.0),
            (DVec3::new(300.0, -20.0, 77.0), 10.0),
            (DVec3::new(1e6, 0.0, -1e6), 100.0),
            (UTM.offset, 1000.0),
        ] {
            let mesh = soup(&mut random, place, size);
            let scene = Scene::new(&mesh, &settings).unwrap();
            let shapes = Shapes::new(&mesh, mesh.triangles());
            let mut queries = scene.intersector().unwrap();
            for number in 0..2000 {
                let target = shapes.triangles()[number].centroid();
                let way = DVec3::new(random.signed(), random.signed(), random.signed()) * size;
                let origin = (target.as_dvec3() + way * random.uniform()).as_vec3();
                let (ray, Some(met)) = first(&mut queries, origin, target - origin) else { continue };
                let (number, meeting) = shapes.meeting(&ray, &met);
                let triangle = &shapes.triangles()[number as usize];
                let [a, b, c] = triangle.0.map(|vertex| vertex.as_dvec3());
                let longest = (b - a).length().max((c - b).length()).max((a - c).length());
                let width = (b - a).cross(c - a).length() / longest;
                let surface = Surface::new(&meeting, triangle, 0);

                // Nothing but rounding: the start's own, and some units in the last place of the
                // triangle's size.
                let height = (surface.origin.as_dvec3() - meeting.point).dot(meeting.normal);
                let spacing = surface.origin.to_array().map(|x| f64::from(x.abs().next_up() - x.abs()));
                let rounding = 2.0 * meeting.normal.abs().dot(DVec3::from_array(spacing));
                let kernel = 2e-6 * longest * (longest / width);
                assert!(
                    height > 0.0 && height <= rounding + kernel.min(64.0 * width),
                    "{height} {triangle:?}"
                );

                for _ in 0..8 {
                    let direction = surface.cosine_direction([random.unit(), random.unit()]);
                    let (_, back) = first(&mut queries, surface.origin, direction);
                    let back = back.is_some_and(|back| back.triangle == number);
                    asked += 1;
                    if width < 1e-3 * longest {
                        slivers += 1;
                        again += u32::from(back);
                    } else {
                        assert!(!back, "{settings:?} {triangle:?} {surface:?} {direction}");
                    }
                }
            }
        }
    }
    println!("{again} of {slivers} rays from slivers, of {asked}, meet them again");
    assert!(slivers > 1000 && again * 100 < slivers, "{again} of {slivers}");
}

/// A point on a triangle is where it is however far away the ray starts: known here to the last
/// bit.
#[test]
fn points_do_not_depend_on_the_distance() {
    let triangle = crate::geometry::Triangle([Vec3::ZERO, Vec3::X * 64.0, Vec3::Z * 64.0]);
    for distance in [1.0, 1024.0, 1_048_576.0, 1_073_741_824.0] {
        // Straight down, and with a slope of which the ray's start makes up exactly.
        for slope in [0.0, 0.25] {
            let origin = Vec3::new(5.0 - slope * distance, distance, 7.0);
            let ray = Ray { origin, tnear: 0.0, direction: Vec3::new(slope, -1.0, 0.0), tfar: f32::INFINITY };
            let rounded = DVec3::new(f64::from(origin.x) + f64::from(slope * distance), 0.0, 7.0);
            let meeting = Meeting::of(&ray, &triangle);
            assert_eq!((meeting.point, meeting.t), (rounded, f64::from(distance)), "{distance} {slope}");
            assert_eq!((meeting.normal, meeting.miss <= 0.0), (DVec3::Y, true));
        }
    }
}

/// Something a ten-thousandth of a surface's size above it casts its shadow.
#[test]
fn what_is_near_is_met() {
    for place in [HOME, moved(1e6, 0.0, 1e6), UTM, Place { scale: 1e-3, ..HOME }] {
        let floor = quad(Vec3::ZERO, Vec3::X * 64.0, Vec3::Z * 64.0);
        let above = floor.map(|corner| corner + Vec3::Y / 128.0);
        let mesh = place.mesh(&mesh(&[(&[floor], Material::default()), (&[above], Material::default())]));
        let shapes = Shapes::new(&mesh, mesh.triangles());
        for settings in kernels() {
            let scene = Scene::new(&mesh, &settings).unwrap();
            let mut queries = scene.intersector().unwrap();
            let mut random = Random::new(5);
            for _ in 0..1000 {
                let point = Vec3::new(8.0 + 48.0 * random.unit(), 0.0, 8.0 + 48.0 * random.unit());
                // Down from between the two, and up again from the floor.
                let from = place.of(point + Vec3::Y / 256.0);
                let (ray, met) = first(&mut queries, from, Vec3::NEG_Y);
                let met = met.unwrap();
                assert_eq!(met.part, 0);
                let (number, meeting) = shapes.meeting(&ray, &met);
                let origin = meeting.origin(&shapes.triangles()[number as usize]);
                let next = first(&mut queries, origin, Vec3::Y).1.unwrap();
                assert_eq!(next.part, 1, "{place:?} {settings:?} {origin}");
            }
        }
    }
}
