//! Two recordings, whatever their chunks and codecs: what is said of their headers, and then every query.

use super::tally::Tally;
use super::{DiffError, Options, Report, Tolerance, any_order, in_order};
use crate::diff::report::{First, Value};
use crate::format::rays::Rays;
use crate::progress::Progress;

/// Compares two files. What counts: the fields of every record, its rejects and its scene, and the scene fingerprint where both know
/// it and no tolerance allows for other geometry. What is noted: Embree's version, the promise of an order, a file that was cut off.
/// What is ignored: producer, thread, sequence number, chunks and codecs.
pub(super) fn compare(
    a: &[u8],
    b: &[u8],
    options: &Options,
    progress: &Progress,
) -> Result<Report, DiffError> {
    let rays_a = Rays::parse(a).map_err(DiffError::A)?;
    let rays_b = Rays::parse(b).map_err(DiffError::B)?;
    let (count_a, count_b) = (rays_a.query_count(), rays_b.query_count());
    for (count, name) in [(count_a, "A"), (count_b, "B")] {
        if count == 0 {
            return Err(DiffError::NoQueries(name));
        }
    }
    let report = Report { unit: "queries", count_a, count_b, ..Report::default() };
    let mut tally = Tally::new(report, options);
    if options.any_order {
        any_order::compare(&rays_a, &rays_b, &mut tally, progress)?;
    } else {
        in_order::compare(&rays_a, &rays_b, &mut tally, progress)?;
    }
    let mut report = tally.finish()?;
    // Behind the queries: which of them differ says more than that the scene does.
    compare_headers(&rays_a, &rays_b, options, &mut report);
    Ok(report)
}

fn compare_headers(a: &Rays, b: &Rays, options: &Options, report: &mut Report) {
    let (header_a, header_b) = (&a.header, &b.header);
    let fingerprint = |value: u64| format!("{value:016x}");
    let (known_a, known_b) = (header_a.fingerprint, header_b.fingerprint);
    if known_a != known_b {
        let value = Value::new("scene fingerprint", fingerprint(known_a), fingerprint(known_b));
        if known_a != 0 && known_b != 0 && options.questions == Tolerance::Exact {
            report.differ(&["fingerprint"], || First { element: "header".into(), values: vec![value] });
        } else {
            report.notes.push(value);
        }
    }
    report.note("Embree version", header_a.embree_version, header_b.embree_version);
    report.note("order does not depend on threads", header_a.deterministic, header_b.deterministic);
    report.note("recording was cut off", a.recovery.is_some(), b.recovery.is_some());
}
