//! Which steady stretches of an array's mean output are rests: an array that turns evenly about the
//! vertical has a steady mean too, equation (100).

use nalgebra::{DVector, Vector3};
use wimu_nav::array::ArraySolver;

use super::motion::axes;
use super::outputs::{Span, mean, pose};
use super::{Array, ArrayGeometry};
use crate::Result;
use crate::stats::median;

/// Length of a block, s.
const BLOCK_S: f64 = 0.1;
/// Fewest samples of a block.
const BLOCK_SAMPLES: usize = 5;
/// Shortest rest, blocks.
const REST_BLOCKS: usize = 3;
/// Standard deviation of the change of a bias between blocks and between rests, m/s².
const BLOCK_BIAS_MPS2: f64 = 0.01;
pub(super) const REST_BIAS_MPS2: f64 = 0.015;
/// Biases and relative errors of scale and direction of a sensor that is not calibrated yet.
const BIAS_MPS2: f64 = 0.5;
const SCALE: f64 = 0.03;
/// χ² from which on neighbouring blocks are not the same stretch (of nine degrees of freedom), and from
/// which on a stretch turns (of three).
const CHANGED: f64 = 45.0;
const TURNS: f64 = 40.0;

/// A stretch in which the mean output is steady while the array turns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EvenTurn {
    /// First sample and number of samples.
    pub span: Span,
    /// Angular rate that the sensors' departures from each other show, rad/s.
    pub rate_rad_s: f64,
}

/// Rests, and what is no rest.
#[derive(Default)]
pub(super) struct Judged {
    pub rests: Vec<Span>,
    pub turns: Vec<EvenTurn>,
    /// Below this angular rate, rad/s, an even turn about the vertical looks like the rests; `None`
    /// where the sensors show no angular rate at all.
    pub unseen_rad_s: Option<f64>,
}

/// Mean of all axes over a stretch; an axis without a value has 0.
struct Mean {
    output: DVector<f64>,
    variance: f64,
    samples: f64,
}

impl Mean {
    fn of(recording: &Array, span: Span, used: &[bool]) -> Self {
        let mut output = DVector::zeros(3 * used.len());
        let (mut variance, mut count) = (0.0, 0.0);
        for sensor in (0..used.len()).filter(|s| used[*s]) {
            if let Some(pose) = pose(recording, sensor, span) {
                output.rows_mut(3 * sensor, 3).copy_from_slice(&pose.mean_mps2);
                variance += pose.sd_mps2[0].powi(2);
                count += 1.0;
            }
        }
        Self { output, variance: variance / f64::max(count, 1.0), samples: span.1 as f64 }
    }

    /// Mean of the sensors.
    fn force(&self, used: &[bool]) -> Vector3<f64> {
        let sensors = (0..used.len()).filter(|s| used[*s]);
        mean(sensors.map(|s| self.output.fixed_rows::<3>(3 * s).into_owned()))
    }
}

/// Judges stretches in which the mean of the sensors is steady by what the sensors that are `used` put
/// out there among each other.
pub(super) fn judged(
    recording: &Array,
    geometry: &ArrayGeometry,
    stretches: &[Span],
    used: &[bool],
) -> Result<Judged> {
    let axes = axes(geometry, &vec![1.0; geometry.sensors.len()])?;
    let solver = match ArraySolver::of(&axes, |sensor| used[sensor]) {
        Ok(solver) if solver.rank() > 0 => solver,
        // What is missing is said where the motion is looked for.
        _ => {
            return Ok(Judged { rests: stretches.to_vec(), ..Judged::default() });
        }
    };
    let spans: Vec<Span> =
        stretches.iter().flat_map(|stretch| steady(recording, &solver, *stretch, used)).collect();
    let means: Vec<Mean> = spans.iter().map(|span| Mean::of(recording, *span, used)).collect();
    // What one rest's departures show beyond what the biases explain.
    let turn = |departure: &DVector<f64>, variance: f64| -> Option<f64> {
        let departure = departure.as_slice();
        let linear = solver.reduce(departure);
        let apart = solver.excess(departure, &linear).unwrap_or(0.0);
        let roots = solver.roots_of(&linear);
        let best = roots.first()?;
        let explained = linear.z.norm_squared() - best.chi_square;
        (explained > TURNS * variance.max(apart)).then(|| best.rate_rad_s.norm())
    };
    let of_rest = |mean: &Mean| REST_BIAS_MPS2.powi(2) + mean.variance / mean.samples;
    let unknown = |force: Vector3<f64>| BIAS_MPS2.powi(2) + (SCALE * force.norm()).powi(2);
    let mut judged = Judged::default();
    for (span, one) in spans.iter().zip(&means) {
        let force = one.force(used);
        let by_itself = turn(&one.output, unknown(force) + of_rest(one));
        let against = means.iter().filter_map(|other| {
            let scale = SCALE * (force - other.force(used)).norm();
            let variance = of_rest(one) + of_rest(other) + scale * scale;
            turn(&(&one.output - &other.output), variance)
        });
        match by_itself.into_iter().chain(against).reduce(f64::max) {
            Some(rate_rad_s) => judged.turns.push(EvenTurn { span: *span, rate_rad_s }),
            None => judged.rests.push(*span),
        }
    }
    if let Some(first) = means.first() {
        let force = first.force(used);
        let (z, _) = solver.expected_z(&(force / force.norm().max(1e-9)));
        let shown = z.norm().max(1e-12);
        let variance = if means.len() > 1 { 2.0 * of_rest(first) } else { unknown(force) };
        judged.unseen_rad_s = Some(((TURNS * variance).sqrt() / shown).sqrt());
    }
    Ok(judged)
}

/// The parts of a stretch in which the sensors agree with each other in the same way.
fn steady(
    recording: &Array,
    solver: &ArraySolver,
    (first, count): Span,
    used: &[bool],
) -> Vec<Span> {
    let length = ((BLOCK_S / recording.period_s()).ceil() as usize).max(BLOCK_SAMPLES);
    let blocks: Vec<Mean> = (0..count / length)
        .map(|b| Mean::of(recording, (first + b * length, length), used))
        .collect();
    let Some(noise) = median(blocks.iter().map(|b| b.variance)) else {
        return vec![(first, count)];
    };
    let variance = BLOCK_BIAS_MPS2.powi(2) + noise / length as f64;
    let differs = |a: &DVector<f64>, b: &DVector<f64>, variance: f64| {
        let linear = solver.reduce((a - b).as_slice());
        let turn = (0..3).map(|i| linear.theta[i].powi(2) / solver.covariance()[(i, i)]);
        linear.z.norm_squared() + turn.sum::<f64>() > CHANGED * variance
    };
    // Runs of blocks, and the mean of each.
    let mut runs: Vec<(usize, usize, DVector<f64>)> = Vec::new();
    for (at, block) in blocks.iter().enumerate() {
        if let Some((begin, end, mean)) = runs.last_mut() {
            let n = (*end - *begin) as f64;
            let alike = !differs(&block.output, mean, variance * (1.0 + 1.0 / n))
                && !differs(&block.output, &blocks[*begin].output, 2.0 * variance);
            if alike {
                *mean += (&block.output - &*mean) / (n + 1.0);
                *end = at + 1;
                continue;
            }
        }
        runs.push((at, at + 1, block.output.clone()));
    }
    if let [_] = runs[..] {
        return vec![(first, count)];
    }
    runs.iter()
        .filter(|(begin, end, _)| end - begin >= REST_BLOCKS)
        .map(|(begin, end, _)| (first + begin * length, (end - begin) * length))
        .collect()
}
