//! The solver of an array, in f32.

use core::hint::black_box;

use wimu_nav::array::{ArraySolver, Geometry, Solution};

use crate::counter::Counter;
use crate::report;

/// Samples solved per array.
const SAMPLES: u32 = 64;

#[inline(never)]
fn solve<const M: usize>(solver: &ArraySolver<f32, M>, output: &[f32; M]) -> Solution<f32> {
    solver.solve(output)
}

/// Measures the solution of one sample: ω, ω̇ and s of all roots.
pub fn measure(counter: &Counter) -> Result<(), &'static str> {
    let refused = |_| "the geometry is refused";
    // Lengths in m, noise 0.05 m/s².
    measure_one(counter, "array-four", &|| {
        Geometry::<12>::four_triads(0.0134, 0.05).map_err(refused)
    })?;
    measure_one(counter, "array-eight", &|| {
        Geometry::<24>::eight_triads_board(0.00945, 0.002, 0.05).map_err(refused)
    })
}

#[inline(never)]
fn measure_one<const M: usize>(
    counter: &Counter,
    name: &str,
    geometry: &dyn Fn() -> Result<Geometry<M>, &'static str>,
) -> Result<(), &'static str> {
    let geometry = &geometry()?;
    let solver = &ArraySolver::<f32, M>::new(geometry).map_err(|_| "no solver")?;
    let (mut sum, mut most) = (0, 0);
    let mut state = 1u32;
    let mut random = |size: f32| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ((state >> 8) as f32 / 8_388_608.0 - 1.0) * size
    };
    for _ in 0..SAMPLES {
        // rad/s, rad/s² and m/s², body axes.
        let rate = [random(20.0), random(20.0), random(20.0)];
        let angular_acceleration = [random(200.0), random(200.0), random(200.0)];
        let force = [random(20.0), random(20.0), random(20.0)];
        let mut output = [0.0; M];
        for (value, axis) in output.iter_mut().zip(geometry.axes()) {
            let position_m = axis.position_m.map(|p| p as f32);
            let tangential = cross(angular_acceleration, position_m);
            let centripetal = cross(rate, cross(rate, position_m));
            for i in 0..3 {
                *value += axis.direction[i] as f32 * (force[i] + tangential[i] + centripetal[i]);
            }
            *value += random(0.1);
        }
        let mut found = false;
        let cost = counter.count(|| {
            found = black_box(solve(black_box(solver), &output)).is_ambiguous();
        });
        if !found {
            return Err("the solver finds no angular rate (is_ambiguous is false)");
        }
        sum += cost;
        most = most.max(cost);
    }
    report(name, sum, SAMPLES, most);
    Ok(())
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
