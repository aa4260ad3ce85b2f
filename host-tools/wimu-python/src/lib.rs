//! Python module of wimu: `README.md` shows its use, `wimu.pyi` documents every name. It converts arguments and results;
//! `wimu-host` computes.

mod arrays;
mod calibration;
mod corrected;
mod failure;
mod noise;
mod path;
mod recording;

/// Recordings, calibration, noise and paths of accelerometers and IMUs.
#[pyo3::pymodule]
mod wimu {
    #[pymodule_export]
    use super::calibration::{Calibration, calibrate};
    #[pymodule_export]
    use super::corrected::{Corrected, apply};
    #[pymodule_export]
    use super::failure::WimuError;
    #[pymodule_export]
    use super::noise::{Noise, allan};
    #[pymodule_export]
    use super::path::{Move, Path, navigate};
    #[pymodule_export]
    use super::recording::{Recording, Track, read};
}
