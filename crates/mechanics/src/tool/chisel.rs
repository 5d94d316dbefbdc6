use crate::contact::{RigidShape, SIDE_DEPTH, SurfaceSample};
use crate::geometry::{Aabb, DistanceGrid, TriMesh, Vec3};

/// Measures of a chisel's blade.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChiselParameters {
    /// Along the cutting edge \[mm\], 2 to 30.
    pub width: f64,
    /// Of the blade behind the bevel \[mm\], 1 to 8.
    pub thickness: f64,
    /// Whole angle of the wedge, ground on both sides \[degrees\], 8 to 90.
    pub bevel_deg: f64,
    /// From the edge to the handle \[mm\], 20 to 150.
    pub length: f64,
}

impl Default for ChiselParameters {
    /// 10 mm wide, 3 mm thick, 20 degrees, 60 mm long.
    fn default() -> Self {
        Self {
            width: 10.0,
            thickness: 3.0,
            bevel_deg: 20.0,
            length: 60.0,
        }
    }
}

/// Why a chisel was refused.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum ChiselError {
    /// A measure out of its range.
    #[error("chisel {name} is {value} {unit}; it must lie between {low} and {high} {unit}")]
    OutOfRange {
        /// Which measure.
        name: &'static str,
        /// What was given.
        value: f64,
        /// Smallest allowed.
        low: f64,
        /// Largest allowed.
        high: f64,
        /// Of all three.
        unit: &'static str,
    },
    /// The wedge is longer than the blade.
    #[error(
        "a bevel of {bevel_deg} degrees on {thickness} mm is {wedge:.1} mm long, longer than the blade of {length} mm; take a blunter bevel"
    )]
    WedgeTooLong {
        /// Whole angle.
        bevel_deg: f64,
        /// Of the blade.
        thickness: f64,
        /// Length of the wedge.
        wedge: f64,
        /// Of the blade.
        length: f64,
    },
}

/// A chisel's blade: a bar with a wedge at its end.
///
/// Tool frame: origin at the middle of the cutting edge, +z the way it is driven (the body reaches to `z = -length`),
/// x along the edge, y across the blade.
#[derive(Clone, Debug, PartialEq)]
pub struct Chisel {
    parameters: ChiselParameters,
    /// Outline in the (y, z) plane, counter-clockwise with y to the right and z up.
    outline: [[f64; 2]; 6],
}

/// A ground edge is not infinitely sharp \[mm\].
const EDGE_THICKNESS: f64 = 0.3;
/// Of the distance grid, about: x, y, z \[mm\]. Finest across the blade, where the walls of the crack press.
const GRID_SPACING: [f64; 3] = [0.4, 0.15, 0.3];
/// Grid cells around the blade.
const GRID_MARGIN: f64 = 2.0;
/// Between samples of the surface \[mm\].
const SAMPLE_SPACING: f64 = 2.0;

/// A wall is pushed off its side of the blade, not off the blade's narrow ends or its edge (that would lift a twisted blade out of
/// the slit): only where a point is this much nearer to the end does it go that way.
const END_STEEPNESS: f64 = 3.0;

impl Chisel {
    /// Checks the measures.
    ///
    /// # Errors
    /// [`ChiselError`] for a measure out of range and a wedge longer than the blade.
    pub fn new(parameters: ChiselParameters) -> Result<Self, ChiselError> {
        let p = parameters;
        check("width", p.width, [2.0, 30.0], "mm")?;
        check("thickness", p.thickness, [1.0, 8.0], "mm")?;
        check("bevel_deg", p.bevel_deg, [8.0, 90.0], "degrees")?;
        check("length", p.length, [20.0, 150.0], "mm")?;
        let (edge, half) = (0.5 * EDGE_THICKNESS, 0.5 * p.thickness);
        let wedge = (half - edge) / (0.5 * p.bevel_deg.to_radians()).tan();
        if wedge >= p.length {
            return Err(ChiselError::WedgeTooLong {
                bevel_deg: p.bevel_deg,
                thickness: p.thickness,
                wedge,
                length: p.length,
            });
        }
        let right = [[half, -p.length], [half, -wedge], [edge, 0.0]];
        let left = [[-edge, 0.0], [-half, -wedge], [-half, -p.length]];
        let outline = [right[0], right[1], right[2], left[0], left[1], left[2]];
        Ok(Self {
            parameters,
            outline,
        })
    }

    /// The measures.
    pub fn parameters(&self) -> &ChiselParameters {
        &self.parameters
    }

    /// Exact signed distance to the blade's surface \[mm\], negative inside; `p` in the tool frame.
    pub fn distance(&self, p: &Vec3) -> f64 {
        self.extruded(p, polygon_distance(&self.outline, [p.y, p.z]))
    }

    /// The blade for contact.
    pub fn shape(&self) -> RigidShape {
        let side = |outline: [[f64; 2]; 6]| {
            self.grid(SIDE_DEPTH, |p| {
                let along = p.x.abs() - 0.5 * self.parameters.width;
                let side = polygon_distance(&outline, [p.y, p.z]);
                side.max(END_STEEPNESS * along.max(p.z))
            })
        };
        RigidShape {
            field: self.grid(0.0, |p| self.distance(p)),
            sided: Some([side(self.extended(1.0)), side(self.extended(-1.0))]),
            bounds: self.bounds(),
            bevels: self.bevels(),
            samples: self.samples(),
        }
    }

    /// The closed surface, outward.
    pub fn surface(&self) -> TriMesh {
        let half = 0.5 * self.parameters.width;
        let ring = |x: f64| self.outline.map(|[y, z]| Vec3::new(x, y, z));
        let vertices = [ring(half), ring(-half)].concat();
        // Seen from +x, y to the right and z up: the outline runs counter-clockwise.
        let mut triangles = Vec::new();
        for k in 0..6u32 {
            let next = (k + 1) % 6;
            triangles.extend([[k, k + 6, next + 6], [k, next + 6, next]]);
        }
        for k in 1..5 {
            triangles.extend([[0, k, k + 1], [6, k + 7, k + 6]]);
        }
        TriMesh {
            vertices,
            triangles,
        }
    }

    /// The ground faces, towards -y and +y: see [`RigidShape::bevels`].
    fn bevels(&self) -> [[f32; 3]; 2] {
        let [[far, back], [near, edge]] = [self.outline[1], self.outline[2]];
        let length = (far - near).hypot(edge - back);
        let (a, b) = ((edge - back) / length, (far - near) / length);
        let c = a * near + b * edge;
        [-a, a].map(|a| [a as f32, b as f32, c as f32])
    }

    fn bounds(&self) -> Aabb {
        let p = &self.parameters;
        Aabb {
            min: Vec3::new(-0.5 * p.width, -0.5 * p.thickness, -p.length),
            max: Vec3::new(0.5 * p.width, 0.5 * p.thickness, 0.0),
        }
    }

    /// A distance on a grid with nodes on the blade's flat faces, so that these are exact.
    /// Samples a distance on the blade's box, widened by `beside` on both sides of the blade.
    fn grid(&self, beside: f64, distance: impl Fn(&Vec3) -> f64) -> DistanceGrid {
        let mut bounds = self.bounds();
        bounds.min.y -= beside;
        bounds.max.y += beside;
        let mut spacing = GRID_SPACING;
        for k in 0..3 {
            let extent = bounds.extent()[k];
            spacing[k] = extent / (extent / GRID_SPACING[k]).ceil();
            bounds.min[k] -= GRID_MARGIN * spacing[k];
            bounds.max[k] += GRID_MARGIN * spacing[k];
        }
        DistanceGrid::sample(bounds, spacing, distance)
            .expect("checked measures give a grid of moderate size")
    }

    fn extruded(&self, p: &Vec3, in_plane: f64) -> f64 {
        let along = p.x.abs() - 0.5 * self.parameters.width;
        along.max(in_plane).min(0.0) + along.max(0.0).hypot(in_plane.max(0.0))
    }

    /// The outline with everything on the `side` (+1, -1) of y filled far beyond the blade, and far below its edge.
    fn extended(&self, side: f64) -> [[f64; 2]; 6] {
        let o = &self.outline;
        let (far, back, below) = (side * 100.0, -self.parameters.length, 100.0);
        if side > 0.0 {
            [
                [far, back],
                [far, below],
                [o[3][0], below],
                o[3],
                o[4],
                o[5],
            ]
        } else {
            [
                o[0],
                o[1],
                o[2],
                [o[2][0], below],
                [far, below],
                [far, back],
            ]
        }
    }

    /// Points in rows on the six faces around, each with the area it stands for.
    fn samples(&self) -> Vec<SurfaceSample> {
        let mut samples = Vec::new();
        let width = self.parameters.width;
        let n_across = (width / SAMPLE_SPACING).ceil() as usize;
        for k in 0..6 {
            let [a, b] = [self.outline[k], self.outline[(k + 1) % 6]];
            let length = (b[0] - a[0]).hypot(b[1] - a[1]);
            let n_along = (length / SAMPLE_SPACING).ceil() as usize;
            let patch = width * length / (n_across * n_along) as f64;
            for i in 0..=n_along {
                let t = i as f64 / n_along as f64;
                for j in 0..=n_across {
                    let x = width * (j as f64 / n_across as f64 - 0.5);
                    let position = Vec3::new(x, a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]));
                    let area = patch * border_half(i, n_along) * border_half(j, n_across);
                    samples.push(SurfaceSample { position, area });
                }
            }
        }
        samples
    }
}

/// The trapezoidal rule: a point on the border stands for half a patch.
fn border_half(i: usize, n: usize) -> f64 {
    if i == 0 || i == n { 0.5 } else { 1.0 }
}

fn check(
    name: &'static str,
    value: f64,
    [low, high]: [f64; 2],
    unit: &'static str,
) -> Result<(), ChiselError> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(ChiselError::OutOfRange {
        name,
        value,
        low,
        high,
        unit,
    })
}

/// Signed distance to a simple polygon, negative inside (even-odd rule).
fn polygon_distance<const N: usize>(polygon: &[[f64; 2]; N], p: [f64; 2]) -> f64 {
    let mut nearest = f64::INFINITY;
    let mut inside = false;
    for k in 0..N {
        let ([ax, ay], [bx, by]) = (polygon[k], polygon[(k + 1) % N]);
        let (ex, ey) = (bx - ax, by - ay);
        let (wx, wy) = (p[0] - ax, p[1] - ay);
        let t = ((wx * ex + wy * ey) / (ex * ex + ey * ey)).clamp(0.0, 1.0);
        nearest = nearest.min((wx - t * ex).hypot(wy - t * ey));
        if (ay > p[1]) != (by > p[1]) && wx < ex * wy / ey {
            inside = !inside;
        }
    }
    if inside { -nearest } else { nearest }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chisel() -> Chisel {
        Chisel::new(ChiselParameters::default()).unwrap()
    }

    #[test]
    fn bad_measures_are_named() {
        let with = |change: fn(&mut ChiselParameters)| {
            let mut p = ChiselParameters::default();
            change(&mut p);
            Chisel::new(p).unwrap_err().to_string()
        };
        assert_eq!(
            with(|p| p.width = 0.0),
            "chisel width is 0 mm; it must lie between 2 and 30 mm"
        );
        assert!(with(|p| p.length = f64::NAN).contains("length is NaN"));
        let long = with(|p| (p.thickness, p.bevel_deg, p.length) = (8.0, 8.0, 50.0));
        assert!(long.contains("longer than the blade"), "{long}");
    }

    #[test]
    fn the_surface_is_closed_and_lies_at_distance_zero() {
        let chisel = chisel();
        let mesh = chisel.surface();
        assert!(mesh.border_edges().is_empty());
        // Bar of 60 x 10 x 3 less the two ground-off triangles of 1.35 mm by the wedge's length.
        let wedge = 1.35 / 10.0f64.to_radians().tan();
        assert!((mesh.volume() - (1800.0 - 10.0 * 1.35 * wedge)).abs() < 1e-9);
        let samples = chisel.shape().samples;
        for s in &samples {
            assert!(chisel.distance(&s.position).abs() < 1e-12);
        }
        let caps = 2.0 * (180.0 - 1.35 * wedge);
        let area: f64 = samples.iter().map(|s| s.area).sum();
        assert!((area + caps - mesh.area()).abs() < 1e-9);
    }

    #[test]
    fn distance_by_hand() {
        let c = chisel();
        let at = |x, y, z| c.distance(&Vec3::new(x, y, z));
        assert!((at(0.0, 0.0, 2.0) - 2.0).abs() < 1e-12);
        assert!((at(8.0, 0.0, 4.0) - 5.0).abs() < 1e-12);
        assert!((at(0.0, 0.0, -30.0) + 1.5).abs() < 1e-12);
        assert!((at(4.5, 1.0, -30.0) + 0.5).abs() < 1e-12);
        assert!((at(0.0, 3.5, -30.0) - 2.0).abs() < 1e-12);
    }

    /// Exact on the flat sides; near the edges off by less than the finest spacing.
    #[test]
    fn the_grid_follows_the_exact_distance() {
        let (chisel, shape) = (chisel(), chisel().shape());
        let mut worst = 0.0f64;
        for i in 0..60_000u32 {
            let a = [0.819_172_513_396, 0.671_043_606_704, 0.549_700_477_901];
            let t = a.map(|a| (0.5 + a * f64::from(i + 1)).fract());
            let p = Vec3::new(10.4 * t[0] - 5.2, 3.2 * t[1] - 1.6, -60.2 * t[2] + 0.2);
            let sample = shape.field.look_up([0, 1, 2].map(|k| p[k] as f32)).unwrap();
            let error = (f64::from(sample.distance) - chisel.distance(&p)).abs();
            worst = worst.max(error);
            // The flat sides, far from where the nearest face changes.
            if p.z < -9.0 && p.z > -55.0 && p.x.abs() < 3.0 && p.y.abs() > 0.2 {
                assert!(error < 1e-5, "{error} at {p}");
            }
        }
        assert!(worst < 0.15, "{worst}");
    }

    #[test]
    fn behind_its_own_side() {
        let sided = chisel().shape().sided.unwrap();
        // 0.1 mm over the middle of the edge's blade, 5 mm behind the edge: half the thickness there, and 0.1 more for
        // the wall whose bone lies below.
        let half = (0.15 + 5.0 * 10.0f64.to_radians().tan()) as f32;
        let cosine = 10.0f32.to_radians().cos();
        let depth = |k: usize, y| -sided[k].look_up([0.0, y, -5.0]).unwrap().distance;
        assert!((depth(0, 0.1) - (half + 0.1) * cosine).abs() < 0.02);
        assert!((depth(1, 0.1) - (half - 0.1) * cosine).abs() < 0.02);
        assert!(sided[0].look_up([0.0, 0.1, -5.0]).unwrap().gradient[1] < -0.9);
    }
}
