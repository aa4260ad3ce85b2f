//! Covariances as CAL.json holds them: `{"order": [parameter, …], "cholesky": [[L₁₁], [L₂₁, L₂₂], …]}` of L Lᵀ, exactly as
//! a board stores it.

use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

#[derive(Serialize, Deserialize)]
struct Factor {
    order: Vec<String>,
    /// L, lower triangular, row by row.
    cholesky: Vec<Vec<f32>>,
}

impl Factor {
    fn new(order: Vec<String>, elements: &[f32]) -> Self {
        let row = |row: usize| elements[row * (row + 1) / 2..(row + 1) * (row + 2) / 2].to_vec();
        Self { cholesky: (0..order.len()).map(row).collect(), order }
    }

    /// The elements of L, if it has this order.
    fn elements<E: Error>(self, order: &[String]) -> Result<Vec<f32>, E> {
        let rows = self.cholesky.iter().map(Vec::len);
        if self.order != order || !rows.eq(1..=order.len()) {
            return Err(E::custom(format!("a covariance is not one of {}", order.join(", "))));
        }
        Ok(self.cholesky.concat())
    }
}

/// That of an error model.
pub mod of_model {
    use wimu_calib::Parameter;
    use wimu_model::ModelCovariance;

    use super::*;

    fn order() -> Vec<String> {
        Parameter::ALL.map(|parameter| parameter.to_string()).into()
    }

    pub fn serialize<S: Serializer>(known: &ModelCovariance, out: S) -> Result<S::Ok, S::Error> {
        Factor::new(order(), known.factor().as_flattened()).serialize(out)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(input: D) -> Result<ModelCovariance, D::Error> {
        let elements = Factor::deserialize(input)?.elements(&order())?;
        let mut rows = [[0.0; 13]; 6];
        rows.as_flattened_mut().copy_from_slice(&elements);
        ModelCovariance::from_factor(rows).map_err(D::Error::custom)
    }
}

/// That of an alignment, if it was measured.
pub mod of_rotation {
    use wimu_model::RotationCovariance;

    use super::*;

    fn order() -> Vec<String> {
        ["X", "Y", "Z"].map(|axis| format!("rotation about {axis}")).into()
    }

    pub fn serialize<S: Serializer>(
        known: &Option<RotationCovariance>,
        out: S,
    ) -> Result<S::Ok, S::Error> {
        let factor = known.map(|known| Factor::new(order(), known.factor().as_flattened()));
        factor.serialize(out)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(
        input: D,
    ) -> Result<Option<RotationCovariance>, D::Error> {
        let Some(factor) = Option::<Factor>::deserialize(input)? else { return Ok(None) };
        let elements = factor.elements(&order())?;
        let mut rows = [[0.0; 6]];
        rows.as_flattened_mut().copy_from_slice(&elements);
        RotationCovariance::from_factor(rows).map(Some).map_err(D::Error::custom)
    }
}
