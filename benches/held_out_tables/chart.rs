//! The figure of `held_out`: what `auto` and the best trees of others cost beside the control, scene by scene.

use super::{Kind, SceneResult};
use embree_trace::files::FileError;
use embree_trace::report::plot::{BLUE, Chart, Figure, GREEN, Mark, PURPLE, Series, Stroke, VERMILLION};
use std::path::Path;

/// Writes `held-out.svg` and `held-out.png`.
pub fn write(scenes: &[SceneResult], directory: &Path) -> Result<(), FileError> {
    // Those where rays bring most stand at the top.
    let mut scenes: Vec<&SceneResult> = scenes.iter().collect();
    scenes.sort_by(|a, b| {
        b.ratio(Kind::AutoOrder, |row| row.all).total_cmp(&a.ratio(Kind::AutoOrder, |row| row.all))
    });
    let series = |label: &str, color, mark, kind, cost| {
        let places = scenes.iter().zip(0u32..);
        let points = places.map(|(scene, place)| (scene.ratio(kind, cost), f64::from(place)));
        Series::line(label, color, Stroke::None, mark, points.filter(|point| point.0.is_finite()).collect())
    };
    let mut chart = Chart::new(
        "",
        "tests per held-out query, relative to our best tree from area",
        "",
        vec![
            series("Embree's tree", PURPLE, Mark::Cross, Kind::Embree, |row| row.all),
            series("best tree of a crate", GREEN, Mark::Ring, Kind::Crate, |row| row.all),
            series("auto, all queries", BLUE, Mark::Disk, Kind::AutoOrder, |row| row.all),
            series("auto for camera queries, on these", VERMILLION, Mark::Disk, Kind::Camera, |row| {
                row.camera
            }),
        ],
    )
    .with_x(0.4, 2.0)
    .with_y(-0.5, scenes.len() as f64 - 0.5);
    chart.y.names = scenes.iter().map(|scene| scene.name.clone()).collect();
    let mut figure = Figure::new("Trees from recorded rays, on rays that they have not seen", 1, vec![chart]);
    figure.chart_size = (860, 120 + 22 * scenes.len() as u32);
    figure.note =
        "Box and primitive tests, depth first; trained on a tenth of the pixels, counted on the others."
            .into();
    figure.write(directory, "held-out")
}
