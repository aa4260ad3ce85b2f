//! The same arithmetic in f32, for comparison.

use wimu_model::Counts;

/// f = M c + o.
pub struct Corrector {
    pub matrix: [[f32; 3]; 3],
    pub offset: [f32; 3],
}

impl Corrector {
    #[inline]
    pub fn correct(&self, counts: Counts) -> [f32; 3] {
        let c = counts.0.map(f32::from);
        core::array::from_fn(|axis| {
            let row = &self.matrix[axis];
            row[0] * c[0] + row[1] * c[1] + row[2] * c[2] + self.offset[axis]
        })
    }
}

/// Trapezoidal integration to velocity and position.
#[derive(Default)]
pub struct Segment {
    pub velocity: [f32; 3],
    pub position: [f32; 3],
    pub previous: [f32; 3],
}

impl Segment {
    #[inline]
    pub fn step(&mut self, force: [f32; 3], gravity: [f32; 3], half_period: f32) {
        for axis in 0..3 {
            let a = force[axis] - gravity[axis];
            let before = self.velocity[axis];
            let after = before + (self.previous[axis] + a) * half_period;
            self.position[axis] += (before + after) * half_period;
            self.velocity[axis] = after;
            self.previous[axis] = a;
        }
    }
}
