//! Orientations of a sensor, with instructions.

use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;
use core::fmt;

use crate::Pose;

/// Name of axis 0, 1 or 2.
pub(crate) fn axis_name(axis: usize) -> &'static str {
    ["X", "Y", "Z"].get(axis).copied().unwrap_or("?")
}

/// Which side of the sensor is up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Face {
    /// The X axis points up.
    XUp,
    /// The X axis points down.
    XDown,
    /// The Y axis points up.
    YUp,
    /// The Y axis points down.
    YDown,
    /// The Z axis points up.
    ZUp,
    /// The Z axis points down.
    ZDown,
}

impl Face {
    /// All sides: X up, X down, Y up, …
    pub const ALL: [Self; 6] =
        [Self::XUp, Self::XDown, Self::YUp, Self::YDown, Self::ZUp, Self::ZDown];

    /// Default names of the sides: those that the axes point out of, and their opposites.
    pub const SIDES: [&'static str; 6] =
        ["+X side", "−X side", "+Y side", "−Y side", "+Z side", "−Z side"];

    /// cos 20°: largest angle of a vertical axis from the vertical.
    const LEAST_COSINE: f64 = 0.94;

    /// The side that is up in `pose`: the axis within 20° of the output.
    ///
    /// `None` when no axis is, or the pose is not finite.
    pub fn of(pose: &Pose) -> Option<Self> {
        let y = pose.mean_mps2;
        let norm = libm::sqrt(y.iter().map(|c| c * c).sum());
        Self::ALL.into_iter().find(|face| {
            let along = face.sign() * y[face.axis()];
            norm > 0.0 && along >= Self::LEAST_COSINE * norm
        })
    }

    /// The vertical axis: 0 = X, 1 = Y, 2 = Z.
    pub fn axis(self) -> usize {
        self as usize / 2
    }

    /// 1 when the axis points up, −1 when it points down.
    pub fn sign(self) -> f64 {
        if (self as usize).is_multiple_of(2) { 1.0 } else { -1.0 }
    }
}

impl fmt::Display for Face {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        Orientation::from(*self).fmt(out)
    }
}

/// One of 26 orientations: up is an axis, midway between two axes, or midway between three.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Orientation([i8; 3]);

impl Orientation {
    /// All orientations: 6 faces, 12 edges and 8 corners of a cube.
    pub const ALL: [Self; 26] = {
        let mut all = [Self([0; 3]); 26];
        let mut code = 0;
        let mut filled = 0;
        while code < 27 {
            let signs = [code % 3 - 1, code / 3 % 3 - 1, code / 9 - 1];
            if code != 13 {
                all[filled] = Self([signs[0] as i8, signs[1] as i8, signs[2] as i8]);
                filled += 1;
            }
            code += 1;
        }
        all
    };

    /// Upside down.
    #[must_use]
    pub fn opposite(self) -> Self {
        Self(self.0.map(|sign| -sign))
    }

    /// Number of axes with a vertical component: 1 a face, 2 an edge, 3 a corner.
    pub(crate) fn axes(self) -> usize {
        self.0.iter().filter(|sign| **sign != 0).count()
    }

    /// Instruction in words, such as "stand it on the edge between +Y side and −X side".
    pub fn instruction(self) -> String {
        self.instruction_with(&Face::SIDES)
    }

    /// Instruction with the names of the sides of a board that +X, −X, +Y, … point out of, such as "left edge".
    pub fn instruction_with(self, sides: &[&str; 6]) -> String {
        // What is down: the side opposite to each axis with a vertical component.
        let down = self.0.iter().enumerate().filter_map(|(axis, sign)| match sign {
            0 => None,
            1.. => sides.get(2 * axis + 1),
            _ => sides.get(2 * axis),
        });
        match Vec::from_iter(down)[..] {
            [side] => format!("lay it on its {side} (arrow {self})"),
            [one, other] => format!("stand it on the edge between {one} and {other}"),
            [one, other, third] => {
                format!("stand it on the corner between {one}, {other} and {third}")
            }
            _ => String::new(),
        }
    }

    /// The up direction, a unit vector in sensor axes.
    pub fn up(self) -> [f64; 3] {
        let signs = self.0.map(f64::from);
        let norm = libm::sqrt(signs.iter().map(|s| s * s).sum());
        signs.map(|s| s / norm)
    }
}

impl From<Face> for Orientation {
    fn from(face: Face) -> Self {
        let mut signs = [0; 3];
        signs[face.axis()] = if face.sign() > 0.0 { 1 } else { -1 };
        Self(signs)
    }
}

impl fmt::Display for Orientation {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let axes = self.axes();
        let mut named = 0;
        for (name, sign) in ["X", "Y", "Z"].into_iter().zip(self.0) {
            let Some(way) =
                [Some("down"), None, Some("up")].get((sign + 1) as usize).copied().flatten()
            else {
                continue;
            };
            if named > 0 {
                out.write_str(if named + 1 == axes { " and " } else { ", " })?;
            }
            write!(out, "{name} {way}")?;
            named += 1;
        }
        match axes {
            2 => out.write_str(" (45° each)"),
            3 => out.write_str(" (35° each)"),
            _ => Ok(()),
        }
    }
}
