//! `bvh-view`: trees, rays, and where the work goes, on screen.
//!
//! [`load`] opens files beside the window; [`shared`] holds what all of the window knows: the camera ([`navigate`]), where one stands in each tree, which
//! [`layers`] are visible, and what is counted in the background ([`results`], by [`crate::explore`]). What keys and clicks mean is up to the current
//! one of the [`modes`]. A picture of the scene is cast by the traversal itself ([`cast`], [`pane`], [`paint`]); what is drawn into it
//! ([`overlay`]) is put over it by the graphics card ([`gpu`]), less of it while the camera moves ([`pace`]). [`session`] puts pictures and [`panels`] into a window, and [`app`] what there is before
//! files are open. A [`window`] shows that; [`offscreen`] draws the same without one.
//!
//! Nothing is computed here that the library does not compute: this module shows.

pub mod app;
pub mod cast;
pub mod diagram;
pub mod gpu;
pub mod heat;
pub mod layers;
pub mod load;
pub mod modes;
pub mod navigate;
pub mod offscreen;
pub mod overlay;
pub mod pace;
pub mod paint;
pub mod pane;
pub mod panels;
pub mod pixels;
pub mod rays;
pub mod results;
pub mod session;
pub mod shared;
pub mod summary;
pub mod versus;
pub mod window;
pub mod wishes;
pub mod work;
