//! Crowns of the lower teeth as simple shapes: what a picture shows and a chisel meets above the gum.
//!
//! A crown is the intersection of a superelliptic column, waisted at the neck, with a rounded occlusal surface. Sizes are means
//! from textbooks of dental anatomy (Wheeler's tables); the shape between them is invented.
use crate::error::AnatomyError;
use crate::mesher;
use osteotome_mechanics::geometry::{Aabb, MeshDistance, SignedDistance, TriMesh, Vec3};

/// The permanent lower teeth from the midline back; third molars are left out, as in most who are operated on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToothKind {
    /// First from the midline.
    CentralIncisor,
    /// Second.
    LateralIncisor,
    /// Third.
    Canine,
    /// Fourth.
    FirstPremolar,
    /// Fifth.
    SecondPremolar,
    /// Sixth.
    FirstMolar,
    /// Seventh.
    SecondMolar,
}

/// Sizes of a crown \[mm\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CrownSize {
    /// Largest width along the tooth row.
    pub mesiodistal: f64,
    /// Largest depth across the tooth row.
    pub buccolingual: f64,
    /// From the neck to the biting edge or the cusps.
    pub height: f64,
    /// Width along and depth across the tooth row at the neck.
    pub neck: [f64; 2],
}

impl ToothKind {
    /// One side's teeth, from the midline back.
    pub const ROW: [Self; 7] = [
        Self::CentralIncisor,
        Self::LateralIncisor,
        Self::Canine,
        Self::FirstPremolar,
        Self::SecondPremolar,
        Self::FirstMolar,
        Self::SecondMolar,
    ];

    /// Textbook means of adults.
    pub fn mean_size(self) -> CrownSize {
        let [mesiodistal, buccolingual, height, along, across] = match self {
            Self::CentralIncisor => [5.0, 6.0, 9.0, 3.5, 5.3],
            Self::LateralIncisor => [5.5, 6.5, 9.5, 4.0, 5.8],
            Self::Canine => [7.0, 7.5, 11.0, 5.5, 7.0],
            Self::FirstPremolar => [7.0, 7.5, 8.5, 5.0, 6.5],
            Self::SecondPremolar => [7.0, 8.0, 8.0, 5.0, 7.0],
            Self::FirstMolar => [11.0, 10.5, 7.5, 9.0, 9.0],
            Self::SecondMolar => [10.5, 10.0, 7.0, 8.0, 9.0],
        };
        CrownSize {
            mesiodistal,
            buccolingual,
            height,
            neck: [along, across],
        }
    }

    /// Name by the notation of the Fédération Dentaire Internationale: 31 to 37 on the left, 41 to 47 on the right.
    pub fn fdi(self, is_left: bool) -> u32 {
        self as u32 + if is_left { 31 } else { 41 }
    }

    fn form(self) -> Form {
        match self {
            Self::CentralIncisor | Self::LateralIncisor => Form {
                edge: [0.95, 0.3],
                power: 2.4,
                fossa: 0.0,
                tip: 0.0,
                rounding: 0.5,
            },
            Self::Canine => Form {
                edge: [0.8, 0.35],
                power: 2.2,
                fossa: 0.0,
                tip: 1.8,
                rounding: 0.7,
            },
            Self::FirstPremolar | Self::SecondPremolar => Form {
                edge: [0.9, 0.75],
                power: 2.3,
                fossa: 1.3,
                tip: 0.0,
                rounding: 1.2,
            },
            Self::FirstMolar | Self::SecondMolar => Form {
                edge: [0.92, 0.82],
                power: 3.2,
                fossa: 1.4,
                tip: 0.0,
                rounding: 1.3,
            },
        }
    }
}

/// What makes the teeth look different; invented.
struct Form {
    /// Width and depth at the biting surface, relative to the largest.
    edge: [f64; 2],
    /// Of the superellipse: 2 is an ellipse, more is squarer.
    power: f64,
    /// Depth of the hollow between the cusps \[mm\].
    fossa: f64,
    /// Height of a single cusp above its shoulders \[mm\].
    tip: f64,
    /// Of the edge around the biting surface \[mm\].
    rounding: f64,
}

/// How deep a crown's shape goes on below the neck \[mm\], so that no gap shows where the bone's crest is uneven.
const STUMP: f64 = 3.0;
/// Fineness of a crown's surface \[mm at scale 1\].
const SURFACE_SPACING: f64 = 0.75;

/// A tooth that the bone carries.
pub trait ToothBody: SignedDistance {
    /// A place in the bone under its neck, by which the bone carries it \[mm\].
    fn anchor(&self) -> Vec3;
}

/// A tooth from a scan: crown alone or with its root.
#[derive(Clone, Debug)]
pub struct ScannedTooth {
    distance: MeshDistance,
    anchor: Vec3,
}

impl ScannedTooth {
    /// A tooth's closed surface, carried by the middle of what of it lies in the bone; one that only touches the bone by a place
    /// in the bone next to it.
    ///
    /// # Errors
    /// [`AnatomyError::Format`] for a tooth that is further than 5 mm from the bone.
    pub fn new(surface: TriMesh, bone: &MeshDistance, name: &str) -> Result<Self, AnatomyError> {
        const REACH: f64 = 5.0;
        /// How deep an anchor lies at least \[mm\].
        const DEPTH: f64 = 1.5;
        let nearest = |p: &Vec3| bone.signed(p);
        let mut inside = (Vec3::zeros(), 0);
        let mut least = (f64::INFINITY, Vec3::zeros());
        for p in &surface.vertices {
            let d = nearest(p);
            if d < 0.0 {
                inside = (inside.0 + p, inside.1 + 1);
            }
            if d < least.0 {
                least = (d, *p);
            }
        }
        if least.0 > REACH {
            return Err(AnatomyError::Format {
                path: name.to_owned(),
                format: "teeth",
                reason: format!(
                    "a tooth near ({:.1}, {:.1}, {:.1}) is {:.1} mm away from the bone; teeth and bone must be in one frame",
                    least.1.x, least.1.y, least.1.z, least.0
                ),
            });
        }
        let middle = if inside.1 > 0 {
            inside.0 / f64::from(inside.1)
        } else {
            least.1
        };
        let mut anchor = middle;
        if bone.signed(&middle) > -DEPTH
            && let Some(near) = bone.closest(&middle)
        {
            anchor = near.point - near.normal * DEPTH;
        }
        Ok(Self {
            distance: MeshDistance::new(surface),
            anchor,
        })
    }

    /// Its surface.
    pub fn mesh(&self) -> &TriMesh {
        self.distance.mesh()
    }
}

impl SignedDistance for ScannedTooth {
    fn signed(&self, p: &Vec3) -> f64 {
        self.distance.signed(p)
    }

    fn bounds(&self) -> Aabb {
        self.distance.bounds()
    }
}

impl ToothBody for ScannedTooth {
    fn anchor(&self) -> Vec3 {
        self.anchor
    }
}

impl ToothBody for Crown {
    fn anchor(&self) -> Vec3 {
        self.anchor()
    }
}

/// One crown in its place. Its sign and zero set are exact, the distance only near the surface.
#[derive(Clone, Debug)]
pub struct Crown {
    /// Which tooth.
    pub kind: ToothKind,
    /// On the patient's left side (positive x).
    pub is_left: bool,
    /// Middle of the neck \[mm\].
    pub neck: Vec3,
    /// Unit vectors along the tooth row, across it, and from the neck to the biting surface.
    pub axes: [Vec3; 3],
    /// Of the jaw; multiplies all sizes.
    pub scale: f64,
}

impl Crown {
    /// The crown on the other side of the midline.
    pub fn mirrored(&self) -> Self {
        let mirror = |v: Vec3| Vec3::new(-v.x, v.y, v.z);
        Self {
            is_left: !self.is_left,
            neck: mirror(self.neck),
            axes: self.axes.map(mirror),
            ..self.clone()
        }
    }

    /// A place in the bone under the neck, by which the bone carries the crown \[mm\].
    pub fn anchor(&self) -> Vec3 {
        self.neck - self.axes[2] * (STUMP * self.scale)
    }

    /// The middle of its biting surface \[mm\].
    pub fn tip(&self) -> Vec3 {
        self.neck + self.axes[2] * (self.kind.mean_size().height * self.scale)
    }

    /// Its closed surface.
    ///
    /// # Errors
    /// As [`mesher::contour`].
    pub fn surface(&self) -> Result<TriMesh, AnatomyError> {
        mesher::contour(self, SURFACE_SPACING * self.scale)
    }

    /// In units of scale 1: along the row, across it, up from the neck.
    fn field(&self, [m, b, t]: [f64; 3]) -> f64 {
        let (size, form) = (self.kind.mean_size(), self.kind.form());
        let up = (t / size.height).clamp(0.0, 1.0);
        let widest = [size.mesiodistal, size.buccolingual];
        // Neighbours touch at three quarters of the height; the tooth bulges towards cheek and tongue low down.
        let half = [0, 1].map(|k| {
            let belly = [0.75, 0.3][k];
            let part = if up < belly {
                let rise = 1.0 - (1.0 - up / belly).powi(2);
                size.neck[k] + (widest[k] - size.neck[k]) * rise
            } else {
                let fall = (up - belly) / (1.0 - belly);
                widest[k] * (1.0 - (1.0 - form.edge[k]) * fall)
            };
            0.5 * part
        });
        let (m, b) = ((m / half[0]).abs(), (b / half[1]).abs());
        let out = (m.powf(form.power) + b.powf(form.power)).powf(1.0 / form.power);
        let inner = half[0].min(half[1]);
        let hollow = form.fossa * (1.0 - out * out).max(0.0) + form.tip * m.min(1.0);
        let above = (t - size.height + hollow).max(-STUMP - t);
        let r = form.rounding.min(0.8 * inner);
        let (side, above) = ((out - 1.0) * inner + r, above + r);
        side.max(above).min(0.0) + side.max(0.0).hypot(above.max(0.0)) - r
    }
}

impl SignedDistance for Crown {
    fn signed(&self, p: &Vec3) -> f64 {
        let d = (p - self.neck) / self.scale;
        self.scale * self.field(self.axes.map(|a| a.dot(&d)))
    }

    fn bounds(&self) -> Aabb {
        let size = self.kind.mean_size();
        let half = Vec3::new(
            0.5 * size.mesiodistal,
            0.5 * size.buccolingual,
            0.5 * (size.height + STUMP),
        );
        let middle = self.neck + self.axes[2] * (0.5 * (size.height - STUMP) * self.scale);
        let reach = Vec3::from_fn(|k, _| (0..3).map(|a| half[a] * self.axes[a][k].abs()).sum());
        Aabb {
            min: middle - reach * self.scale,
            max: middle + reach * self.scale,
        }
    }
}

/// A tooth of a patient.
#[derive(Clone, Debug)]
pub struct Tooth {
    /// In the notation of the Fédération Dentaire Internationale, see [`ToothKind::fdi`].
    pub fdi: u32,
    /// Closed, outward surface of its crown \[mm\]; its lower end lies in the bone.
    pub surface: TriMesh,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::surface::ClosedSurface;

    #[test]
    fn crowns_are_closed_and_of_textbook_size() {
        for kind in ToothKind::ROW {
            let crown = Crown {
                kind,
                is_left: true,
                neck: Vec3::new(3.0, -2.0, 1.0),
                axes: [Vec3::x(), Vec3::y(), Vec3::z()],
                scale: 1.1,
            };
            let mesh = crown.surface().unwrap();
            let closed = ClosedSurface::new(mesh, "crown").unwrap();
            assert!(closed.notes.is_empty(), "{kind:?}: {:?}", closed.notes);
            let size = kind.mean_size();
            let want = Vec3::new(size.mesiodistal, size.buccolingual, size.height + STUMP) * 1.1;
            let found = closed.mesh.bounds().extent();
            // A canine's tip and the cusps are rounded off.
            assert!((found - want).amax() < 0.8, "{kind:?}: {found} not {want}");
            assert!(crown.bounds().grown(0.05).overlaps(&closed.mesh.bounds()));
            let far = closed.mesh.vertices.iter().map(|p| crown.signed(p).abs());
            assert!(far.fold(0.0, f64::max) < 0.1);
        }
    }

    #[test]
    fn a_mirrored_crown_is_a_mirror_image() {
        let crown = Crown {
            kind: ToothKind::FirstMolar,
            is_left: true,
            neck: Vec3::new(25.0, -40.0, -40.0),
            axes: [
                Vec3::new(0.6, 0.8, 0.0),
                Vec3::new(0.8, -0.6, 0.0),
                Vec3::z(),
            ],
            scale: 1.0,
        };
        let other = crown.mirrored();
        assert_eq!(
            (crown.kind.fdi(true), other.kind.fdi(other.is_left)),
            (36, 46)
        );
        for p in [Vec3::new(24.0, -38.0, -36.0), Vec3::new(33.0, -44.0, -35.0)] {
            let q = Vec3::new(-p.x, p.y, p.z);
            assert!((crown.signed(&p) - other.signed(&q)).abs() < 1e-12);
        }
    }
}
