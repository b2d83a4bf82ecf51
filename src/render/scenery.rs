//! What a job looks at: camera, lights, materials. Made once, then shared by all threads.

use crate::geometry::{Aabb, Ray, Triangle, Vec3};
use crate::mesh::Mesh;
use crate::render::camera::{Camera, CameraError, View};
use crate::render::framing::lighting::sky;
use crate::render::framing::{Axes, Framing, guess_up, main_bounds};
use crate::render::lights::Lights;
use crate::render::queries::{Looking, RayQueries};
use crate::render::shapes::{Met, Shapes};
use crate::render::surface::{Appearance, Surface};

/// Everything that integrators need beside the answers to their queries.
#[derive(Clone, Debug)]
pub struct Scenery {
    pub view: View,
    pub camera: Camera,
    pub lights: Lights,
    pub shapes: Shapes,
    /// One per part of the mesh.
    pub appearances: Vec<Appearance>,
    /// How far ambient occlusion looks, in world units.
    pub ao_distance: f32,
}

/// What was said about the camera; the rest is chosen so that the scene can be seen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wishes {
    pub eye_and_target: Option<(Vec3, Vec3)>,
    pub up: Option<Vec3>,
    pub fov_degrees: Option<f32>,
}

impl Wishes {
    /// Says early, before a large scene is read, that no camera can come of this.
    ///
    /// # Errors
    /// As [`Camera::new`], for what was given.
    pub fn check(&self) -> Result<(), CameraError> {
        let fov_degrees = self.fov_degrees.unwrap_or(DEFAULT_FOV);
        let (eye, target) = self.eye_and_target.unwrap_or((Vec3::ZERO, Vec3::ONE));
        let sight = target - eye;
        // Without an up of its own, one that is surely not along the line of sight: the real one is not known yet.
        let up = self.up.unwrap_or_else(|| sight.any_orthogonal_vector());
        Camera::new(&View { eye, target, up, fov_degrees }, 1, 1).map(|_| ())
    }
}

/// Height of the image in degrees for a camera whose place was given.
const DEFAULT_FOV: f32 = 60.0;
/// Ambient occlusion looks this share of the scene's diagonal far.
const AO_SHARE: f32 = 0.1;

/// For a hit of a geometry that is no part of the mesh: it ends the path.
const BLACK: Appearance =
    Appearance { emission: Vec3::ZERO, diffuse: Vec3::ZERO, specular: Vec3::ZERO, specular_share: 0.0 };

impl Scenery {
    /// Chooses what the wishes leave open by asking the scene. `triangles` are the mesh's; the image is `width` × `height`.
    ///
    /// # Errors
    /// When the wishes make no camera, or leave it open where none can be chosen.
    pub fn new<Q: RayQueries>(
        mesh: &Mesh,
        triangles: Vec<Triangle>,
        queries: &mut Q,
        wishes: &Wishes,
        [width, height]: [u32; 2],
    ) -> Result<Scenery, CameraError> {
        let shapes = Shapes::new(mesh, triangles);
        let triangles = shapes.triangles();
        let bounds = main_bounds(triangles);
        let up = wishes.up.filter(|up| up.is_finite() && *up != Vec3::ZERO);
        let axes = up.map_or_else(|| guess_up(triangles, &bounds), Axes::with_up);
        let mut looking = Looking { queries, shapes: &shapes };
        let mut framing = Framing::new(&mut looking, triangles, bounds, axes);
        let view = match wishes.eye_and_target {
            Some((eye, target)) => View {
                eye,
                target,
                up: wishes.up.unwrap_or(axes.up),
                fov_degrees: wishes.fov_degrees.unwrap_or(DEFAULT_FOV),
            },
            None if !triangles.iter().any(Triangle::has_area) => return Err(CameraError::NothingToSee),
            None => framing.view(wishes.fov_degrees, width as f32 / height as f32),
        };
        let finite = triangles.iter().filter(|triangle| triangle.is_finite());
        let all = finite.fold(Aabb::EMPTY, |all, triangle| all.union(&triangle.bounds()));
        let camera = Camera::new(&view, width, height).map_err(|error| match wishes.eye_and_target {
            // Nobody gave what it speaks of.
            None if error == CameraError::Range => CameraError::SceneRange,
            _ => error,
        })?;
        let camera = camera.facing(&all);
        let appearances = Appearance::of_parts(mesh);
        let mut lights = Lights::from_emission(mesh, triangles, &appearances);
        if !lights.has_emitters() {
            lights = Lights::from_sky(sky(&axes, camera.forward), framing.panel(view.eye));
        }
        let ao_distance = AO_SHARE * bounds.extent().length();
        Ok(Scenery { view, camera, lights, shapes, appearances, ao_distance })
    }

    /// The look of what was met.
    #[inline]
    pub fn appearance(&self, part: u32) -> &Appearance {
        self.appearances.get(part as usize).unwrap_or(&BLACK)
    }

    /// Where a ray met what.
    #[inline]
    pub fn surface(&self, ray: &Ray, met: &Met) -> Surface {
        let (number, meeting) = self.shapes.meeting(ray, met);
        Surface::new(&meeting, &self.shapes.triangles()[number as usize], met.part)
    }
}
