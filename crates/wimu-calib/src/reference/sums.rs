//! Sums over samples of two streams, and the moments that follow from them.

use nalgebra::{Matrix3, Vector3};

/// Lags of the lagged products, samples.
pub(super) const LAGS: [usize; 5] = [1, 2, 4, 8, 16];

/// A sample of the reference and of the output, m/s².
pub(super) type Pair = [Vector3<f64>; 2];

/// The latest samples, oldest first, without a gap: as many as the longest lag.
pub(super) type Recent = heapless::Deque<Pair, { LAGS[LAGS.len() - 1] }>;

/// Sums over samples x of the reference and y of the output.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    /// Of each sample with itself.
    own: Products,
    /// Of each sample with the earlier one at each of [`LAGS`].
    lagged: [Products; LAGS.len()],
}

/// Sums of the products of two samples at a fixed lag, symmetrised over the two.
#[derive(Clone, Copy, Debug, Default)]
struct Products {
    n: f64,
    x: Vector3<f64>,
    y: Vector3<f64>,
    xx: Matrix3<f64>,
    /// Axes of the reference (rows) with those of the output (columns).
    xy: Matrix3<f64>,
    /// Each axis of the output with itself.
    yy: Vector3<f64>,
}

impl Products {
    fn take(&mut self, [x, y]: &Pair, [earlier_x, earlier_y]: &Pair) {
        let half = 0.5;
        self.n += 1.0;
        self.xx += (x * earlier_x.transpose() + earlier_x * x.transpose()) * half;
        self.xy += (x * earlier_y.transpose() + earlier_x * y.transpose()) * half;
        self.yy += y.component_mul(earlier_y);
        self.x += (x + earlier_x) * half;
        self.y += (y + earlier_y) * half;
    }

    fn plus(&self, other: &Self, sign: f64) -> Self {
        Self {
            n: self.n + sign * other.n,
            x: self.x + other.x * sign,
            y: self.y + other.y * sign,
            xx: self.xx + other.xx * sign,
            xy: self.xy + other.xy * sign,
            yy: self.yy + other.yy * sign,
        }
    }

    fn central(&self) -> Central {
        let (n, x, y) = (self.n, self.x / self.n, self.y / self.n);
        Central {
            n,
            xx: self.xx / n - x * x.transpose(),
            xy: self.xy / n - x * y.transpose(),
            yy: self.yy / n - y.component_mul(&y),
            x,
            y,
        }
    }
}

impl Sums {
    /// Adds the next sample; `recent` holds the ones before it.
    pub fn take(&mut self, pair: Pair, recent: &mut Recent) {
        for (products, lag) in self.lagged.iter_mut().zip(LAGS) {
            let earlier = recent.len().checked_sub(lag).and_then(|k| recent.get(k));
            if let Some(earlier) = earlier {
                products.take(&pair, earlier);
            }
        }
        self.own.take(&pair, &pair);
        if recent.is_full() {
            recent.pop_front();
        }
        let _ = recent.push_back(pair);
    }

    /// With `sign` times `other` added.
    pub fn plus(&self, other: &Self, sign: f64) -> Self {
        Self {
            own: self.own.plus(&other.own, sign),
            lagged: core::array::from_fn(|i| self.lagged[i].plus(&other.lagged[i], sign)),
        }
    }

    pub fn central(&self) -> Central {
        self.own.central()
    }

    /// Moments of samples at a lag, given by its index in [`LAGS`]: white noise does not contribute.
    pub fn lagged(&self, lag: usize) -> Option<Central> {
        let products = self.lagged.get(lag).filter(|products| products.n >= 1.0)?;
        Some(products.central())
    }

    /// Of one axis.
    pub fn axis(&self, axis: usize) -> AxisSums {
        AxisSums {
            n: self.own.n,
            x: self.own.x[axis],
            y: self.own.y[axis],
            xx: self.own.xx[(axis, axis)],
            xy: self.own.xy[(axis, axis)],
            yy: self.own.yy[axis],
        }
    }
}

/// Means and central second moments of all axes.
pub(super) struct Central {
    pub n: f64,
    pub x: Vector3<f64>,
    pub y: Vector3<f64>,
    pub xx: Matrix3<f64>,
    /// Axes of the reference (rows) with those of the output (columns).
    pub xy: Matrix3<f64>,
    /// Each axis of the output with itself.
    pub yy: Vector3<f64>,
}

/// Sums over samples of an axis.
#[derive(Clone, Copy)]
pub(super) struct AxisSums {
    pub n: f64,
    x: f64,
    y: f64,
    xx: f64,
    xy: f64,
    yy: f64,
}

impl AxisSums {
    /// Without samples at which `side`, 0 the reference, is `at`, and of the other side how many
    /// there are, their sum and that of their squares.
    pub fn without(&self, side: usize, at: f64, [n, other, squares]: [f64; 3]) -> Self {
        let own = [n * at, n * at * at];
        let (x, y) = if side == 0 { (own, [other, squares]) } else { ([other, squares], own) };
        Self {
            n: self.n - n,
            x: self.x - x[0],
            y: self.y - y[0],
            xx: self.xx - x[1],
            xy: self.xy - at * other,
            yy: self.yy - y[1],
        }
    }

    pub fn moments(&self) -> Moments {
        let (x, y) = (self.x / self.n, self.y / self.n);
        Moments {
            x,
            y,
            xx: self.xx / self.n - x * x,
            xy: self.xy / self.n - x * y,
            yy: self.yy / self.n - y * y,
        }
    }
}

/// Means and central second moments of an axis.
pub(super) struct Moments {
    pub x: f64,
    pub y: f64,
    pub xx: f64,
    pub xy: f64,
    pub yy: f64,
}

impl Moments {
    /// Deming's slope for equal noise, equation (50).
    pub fn slope(&self) -> Option<f64> {
        let apart = self.yy - self.xx;
        let root = libm::hypot(apart, 2.0 * self.xy);
        // Two forms of the same root; each keeps its digits on its side.
        let slope = if apart >= 0.0 {
            (apart + root) / (2.0 * self.xy)
        } else {
            2.0 * self.xy / (root - apart)
        };
        (slope.is_finite() && slope != 0.0).then_some(slope)
    }

    /// What is left of y less `slope` times x, squared.
    pub fn left(&self, slope: f64) -> f64 {
        self.yy - 2.0 * slope * self.xy + slope * slope * self.xx
    }
}
