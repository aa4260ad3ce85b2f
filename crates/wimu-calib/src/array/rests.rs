//! Rests in the fit: one force of the length of gravity explains the mean outputs of all axes, equation (99).

use nalgebra::{Matrix3, SVector, Vector3};

use super::fit::{Layout, Row, Sums};
use super::motion::AxisNow;
use super::{ArrayData, ArrayPrior};

/// Iterations for the direction of gravity.
const STEPS: usize = 4;

/// Direction of a rest whose whitened outputs without bias are `output`, and its two orthonormal tangents in the outputs.
fn direction<const M: usize>(
    rows: &[Vector3<f64>; M],
    output: &SVector<f64, M>,
    gravity: f64,
) -> Option<(Vector3<f64>, [SVector<f64, M>; 2])> {
    let information: Matrix3<f64> = rows.iter().map(|m| m * m.transpose()).sum();
    let pulled: Vector3<f64> = rows.iter().zip(output.iter()).map(|(m, y)| m * *y).sum();
    let mut up = information.cholesky()?.solve(&pulled).try_normalize(1e-9)?;
    for _ in 0..STEPS {
        let gradient = pulled - information * up * gravity;
        let tangent = Matrix3::identity() - up * up.transpose();
        let across = tangent * information * tangent * gravity;
        let curved = across + up * up.transpose() * (information.trace() * gravity);
        up = (up + curved.cholesky()?.solve(&(tangent * gradient))).try_normalize(1e-9)?;
    }
    let helper = if up.x.abs() < 0.6 { Vector3::x() } else { Vector3::y() };
    let first = up.cross(&helper).normalize();
    let second = up.cross(&first);
    let in_outputs = |v: Vector3<f64>| SVector::<f64, M>::from_fn(|a, _| rows[a].dot(&v));
    let a = in_outputs(first).try_normalize(0.0)?;
    let b = in_outputs(second);
    let b = (b - a * a.dot(&b)).try_normalize(0.0)?;
    Some((up, [a, b]))
}

/// Mean of each axis over a rest and the square of its whitening factor; an axis without output has weight 0.
pub(super) fn mean_of<const M: usize>(
    data: &ArrayData<'_, M>,
    span: (usize, usize),
    axis: usize,
) -> Option<(f64, f64)> {
    let rows = data.outputs_mps2.get(span.0..span.0.saturating_add(span.1))?;
    let (mut sum, mut count) = (0.0, 0.0);
    for value in rows.iter().map(|row| row[axis]).filter(|v| v.is_finite()) {
        sum += value;
        count += 1.0;
    }
    // A sensor that fails in a rest is not used there.
    (count > 1.0 && 4.0 * count > span.1 as f64).then_some((sum / count, count))
}

/// Adds all rests.
pub(super) fn add<const M: usize>(
    axes: &[AxisNow; M],
    layout: Layout,
    data: &ArrayData<'_, M>,
    prior: &ArrayPrior,
    gravity: f64,
    sums: &mut Sums<'_>,
) {
    for span in data.rests {
        let mut rows = [Vector3::zeros(); M];
        let mut output = SVector::<f64, M>::zeros();
        let mut weights = [0.0; M];
        for (a, axis) in axes.iter().enumerate().take(layout.axes) {
            let mean = mean_of(data, *span, a).filter(|_| axis.weight > 0.0);
            let Some((mean, count)) = mean else { continue };
            let noise = 1.0 / (axis.weight * axis.weight * count);
            weights[a] =
                1.0 / libm::sqrt(noise + prior.repeatability_mps2 * prior.repeatability_mps2);
            rows[a] = axis.m * weights[a];
            output[a] = (mean - axis.bias_mps2) * weights[a];
        }
        let Some((up, tangents)) = direction(&rows, &output, gravity) else {
            continue;
        };
        let force = up * gravity;
        let residual = SVector::<f64, M>::from_fn(|a, _| output[a] - rows[a].dot(&force));
        sums.cost += residual.norm_squared();
        let jacobian: [Row; M] = core::array::from_fn(|a| {
            let w = weights[a];
            let [x, y, z]: [f64; 3] = (force * w).into();
            Row::from([w, x, y, z, 0.0, 0.0, 0.0, 0.0, rows[a].dot(&up)])
        });
        let between = |a: usize, b: usize| {
            let one = f64::from(u8::from(a == b));
            one - tangents[0][a] * tangents[0][b] - tangents[1][a] * tangents[1][b]
        };
        sums.add(&jacobian, |_| layout.gravity(), layout.axes, &residual, between);
        sums.end_block();
    }
}
