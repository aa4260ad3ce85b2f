//! @title@
//!
@convention@

pub const REFERENCE_C: f64 = @t0@;
pub const INPUT_TO_MPS2: f64 = @scale@;
const B0: [f64; 3] = @b0@;
const B1: [f64; 3] = @b1@;
const B2: [f64; 3] = @b2@;
const S1: [f64; 3] = @s1@;
const Q: [f64; 3] = @q@;
const A: [[f64; 3]; 3] = @a@;
const R: [[f64; 3]; 3] = @r@;

fn apply(m: [[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// a⁻¹ y, after the diagonal of a was multiplied by 1 + s dt.
fn solve(mut a: [[f64; 3]; 3], s: [f64; 3], dt: f64, y: [f64; 3]) -> [f64; 3] {
    for (i, row) in a.iter_mut().enumerate() {
        row[i] *= 1.0 + s[i] * dt;
    }
    let minor = |i: usize, j: usize| {
        let (r1, r2, c1, c2) = ((j + 1) % 3, (j + 2) % 3, (i + 1) % 3, (i + 2) % 3);
        a[r1][c1] * a[r2][c2] - a[r1][c2] * a[r2][c1]
    };
    let det = a[0][0] * minor(0, 0) + a[0][1] * minor(1, 0) + a[0][2] * minor(2, 0);
    apply([0, 1, 2].map(|i| [0, 1, 2].map(|j| minor(i, j) / det)), y)
}

/// Specific force, m/s², body axes, of the accelerometer's output at a temperature, °C.
pub fn correct(output: [f64; 3], temperature_c: Option<f64>) -> [f64; 3] {
    let dt = temperature_c.map_or(0.0, |now| now - REFERENCE_C);
    let y = [0, 1, 2].map(|i| output[i] * INPUT_TO_MPS2 - (B0[i] + (B1[i] + B2[i] * dt) * dt));
    let z = solve(A, S1, dt, y);
    apply(R, [0, 1, 2].map(|i| z[i] - Q[i] * z[i] * z[i]))
}
@integers{

/// The same for counts in integers, at REFERENCE_C and without q, for wimu-model:
/// `Corrector::from_parts(CorrectorParts { shift: SHIFT, coefficients: COEFFICIENTS, offset: OFFSET })`.
#[allow(dead_code)]
pub mod integers {
    pub const SHIFT: u8 = @shift@;
    pub const COEFFICIENTS: [[i32; 3]; 3] = @coefficients@;
    pub const OFFSET: [i32; 3] = @offset@;
}
@}
@gyroscope{

/// Angular rate, rad/s, body axes, of the gyroscope's output in @wunit@, with the specific force of [`correct`].
pub fn correct_rate(output: [f64; 3], force: [f64; 3], temperature_c: Option<f64>) -> [f64; 3] {
    const B0: [f64; 3] = @wb0@;
    const B1: [f64; 3] = @wb1@;
    const G: [[f64; 3]; 3] = @wg@;
    let dt = temperature_c.map_or(0.0, |now| now - @wt0@);
    let g = apply(G, [0, 1, 2].map(|i| R[0][i] * force[0] + R[1][i] * force[1] + R[2][i] * force[2]));
    let y = [0, 1, 2].map(|i| output[i] * @wscale@ - (B0[i] + B1[i] * dt) - g[i]);
    apply(R, solve(@wa@, @ws1@, dt, y))
}
@}
