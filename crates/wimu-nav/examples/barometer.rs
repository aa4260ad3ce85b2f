//! A barometer beside the IMU: simulated lifts by 3 m in 4 s, after 4 s of rest and before 22 s of hovering.
//! `cargo run --release -p wimu-nav --example barometer`

use wimu_nav::filter::{Filter, Gate};
use wimu_nav::nalgebra::{Matrix1, Rotation3, Vector1, Vector3};
use wimu_nav::process::{ImuErrors, Process, Strapdown, StrapdownBlocks, Transition};
use wimu_nav::sensor::{Measurement, Prediction, Velocity};
use wimu_nav::state::{Block, Jacobian, Layout, LayoutFull, POSITION, Role, State};

const STEP_S: f64 = 0.01;
const UP: Block<1> = POSITION.part::<1, 2>();
/// Standard deviations: noise of a reading and offset at the start, m; random walk of the offset, m/√s.
const BAROMETER: (f64, f64, f64) = (0.3, 5.0, 0.02);

/// A reading, m: height above the start + offset + noise.
struct Height(f64, Block<1>);
impl<const N: usize> Measurement<f64, N, 1> for Height {
    fn predict(&self, filter: &Filter<f64, N>) -> Prediction<f64, N, 1> {
        let one = Matrix1::identity();
        Prediction {
            innovation: Vector1::new(self.0) - filter.state.get(UP) - filter.state.get(self.1),
            jacobian: Jacobian::zeros().with(UP, one).with(self.1, one),
            covariance: one * BAROMETER.0.powi(2),
        }
    }
}
/// A step of the offset: random walk.
struct Drift(Block<1>);
impl<const N: usize> Process<f64, N> for Drift {
    fn propagate(&self, _: &mut State<f64, N>, transition: &mut Transition<f64, N>) {
        transition.add_noise(self.0, BAROMETER.2.powi(2) * STEP_S);
    }
}

fn main() -> Result<(), LayoutFull> {
    let (errors, gravity_mps2) = (&ImuErrors::default(), wimu_nav::GRAVITY_MPS2);
    let mut layout = Layout::<f64, 16>::new([0.01; 3], 0.01, 0.01);
    let blocks = &StrapdownBlocks::claim(&mut layout, errors)?;
    let offset = layout.claim(Role::Estimated, [BAROMETER.1])?;
    let [without, with] = [false, true].map(|aided| {
        let mut squares = [0.0; 2]; // Means over the draws: error and σ of the height, m².
        for draw in 0..100 {
            let mut random = wimu_testkit::Random::new(draw);
            let mut vector = |deviation| Vector3::from(random.normals(deviation));
            let biases = [errors.accelerometer_bias, errors.gyroscope_bias].map(&mut vector);
            let (mut up_m, mut up_mps, mut offset_m) = (0.0, 0.0, vector(BAROMETER.1).x);
            let mut filter = Filter::new(&layout, Rotation3::identity());
            for step in 0..3000 {
                let up_mps2 = [0.0, 0.0, 0.75, -0.75, 0.0][(step / 200).min(4)];
                up_m += (up_mps + up_mps2 * STEP_S / 2.0) * STEP_S;
                up_mps += up_mps2 * STEP_S;
                offset_m += vector(BAROMETER.2 * STEP_S.sqrt()).x;
                let reading = Height(up_m + offset_m + vector(BAROMETER.0).x, offset);
                let noise = vector(errors.accelerometer_noise / STEP_S.sqrt());
                let strapdown = Strapdown {
                    blocks,
                    errors,
                    gravity_mps2,
                    force_mps2: Vector3::z() * (gravity_mps2 + up_mps2) + biases[0] + noise,
                    rate_rad_s: biases[1] + vector(errors.gyroscope_noise / STEP_S.sqrt()),
                    step_s: STEP_S,
                };
                filter.predict(&(strapdown, Drift(offset)));
                if step < 400 {
                    filter.update(&Velocity::zero(0.01, None), Gate::Open);
                }
                if aided && step % 10 == 9 {
                    filter.update(&reading, Gate::ChiSquare);
                }
            }
            squares[0] += (filter.state.get(UP).x - up_m).powi(2) / 100.0;
            squares[1] += filter.covariance(UP).x / 100.0;
        }
        assert!((0.5..2.0).contains(&(squares[0] / squares[1]))); // σ is consistent.
        squares.map(f64::sqrt)
    });
    println!("RMS error and σ of the height, m: {without:.3?}, with barometer {with:.3?}");
    assert!(with[0] < 0.5 * without[0] && with[1] < 0.5 * without[1]);
    Ok(())
}
