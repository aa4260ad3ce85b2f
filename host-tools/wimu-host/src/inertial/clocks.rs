//! Times of two files that must be those of one clock.

use crate::{Code, Problem, Result};

/// Times since 1970 are above this, s (the year 2001); those since the start of a device are below.
const UNIX_S: f64 = 1e9;

/// A name, and its first and last time, s.
pub(crate) type Span<'a> = (&'a str, [f64; 2]);

/// Refuses spans that do not overlap.
pub(crate) fn one_clock(spans: [Span; 2]) -> Result<()> {
    let [(_, [a, b]), (_, [c, d])] = spans;
    if a <= d && c <= b { Ok(()) } else { Err(other_clock(spans)) }
}

/// The error of spans without a common time.
pub(crate) fn other_clock(spans: [Span; 2]) -> Problem {
    let [(what, [a, b]), (other, [c, d])] = spans;
    let message = format!(
        "none of the {what} is within the time of the {other}: {what} from {a:.2} to {b:.2} s, {other} from {c:.2} to {d:.2} s"
    );
    let mut remedy = "give both the times of one clock".to_owned();
    if let Some(unix) = unix(spans) {
        remedy = format!(
            "the {unix} have Unix times: {remedy}; if both began together, subtract {:.2} s",
            (a - c).abs()
        );
    }
    Code::DataRefused.error(message, remedy)
}

/// The one that has Unix times, if the other has not.
fn unix<'a>(spans: [Span<'a>; 2]) -> Option<&'a str> {
    match spans.map(|(_, [first, _])| first > UNIX_S) {
        [true, false] => Some(spans[0].0),
        [false, true] => Some(spans[1].0),
        _ => None,
    }
}
