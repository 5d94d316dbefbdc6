//! The open mouth around the parametric mandible, as in the procedure: upper jaw with its teeth, lips and a cheek retractor.
//!
//! Schematic: the upper teeth are the lower ones mirrored in the occlusal plane, opened about the condyles; lips and retractor are
//! simple shapes of assumed size. They leave the chisels the way that the surgeon has, and no other.
use crate::error::AnatomyError;
use crate::mesher;
use crate::osteotomy::Side;
use crate::parametric::{Parameters, ParametricMandible, polygon_distance, rounded, smooth_union};
use crate::teeth::Crown;
use osteotome_mechanics::geometry::{Aabb, SignedDistance, TriMesh, Vec3};

/// Fineness of the surfaces \[mm\].
const SPACING: f64 = 1.6;
/// The palate's vault above the necks of the teeth, and half of its thickness \[mm at scale 1\].
const PALATE: [f64; 2] = [11.0, 2.5];
/// Radius of a lip \[mm at scale 1\].
const LIP: f64 = 4.5;
/// Half of the mouth's width, on the free side and where the retractor pulls \[mm at scale 1\].
const MOUTH: [f64; 2] = [32.0, 62.0];
/// The lips lie before the incisors by so much; so much further back at the pulled corner \[mm at scale 1\].
const LIPS: [f64; 2] = [13.0, 35.0];
/// Half of the retractor's blade: thickness, width, length \[mm at scale 1\].
const BLADE: Vec3 = Vec3::new(1.2, 11.0, 36.0);
/// Between the blade's inner end and the cheek's side of the ramus \[mm at scale 1\].
const BLADE_OFF: f64 = 8.0;

/// Each surface with what it is, around a mandible that is operated on the given side.
///
/// # Errors
/// As [`mesher::contour`].
pub fn around(
    mandible: &ParametricMandible,
    side: Side,
) -> Result<Vec<(String, TriMesh)>, AnatomyError> {
    let upper = UpperJaw::opposite(mandible)?;
    let parts: [(&str, &dyn SignedDistance); 3] = [
        ("maxilla", &Maxilla(&upper)),
        ("lips", &Lips::of(&upper, side)),
        ("retractor", &Retractor::of(&upper, side)),
    ];
    let mut all = vec![("upper teeth".to_owned(), upper.teeth()?)];
    for (role, part) in parts {
        all.push((role.to_owned(), mesher::contour(part, SPACING)?));
    }
    Ok(all)
}

/// The lower jaw without its deviation, and how it lies opposite itself.
struct UpperJaw {
    lower: ParametricMandible,
    /// Unit normal of the occlusal plane, up, and its distance from the condyles' axis \[mm\].
    normal: Vec3,
    height: f64,
    /// Sine and cosine of the angle by which the mouth is open.
    turn: [f64; 2],
    outline: Vec<[f64; 2]>,
    /// Tip of the lower central incisors, in the midline, and of the upper ones.
    incisors: [Vec3; 2],
}

impl UpperJaw {
    fn opposite(mandible: &ParametricMandible) -> Result<Self, AnatomyError> {
        let lower = ParametricMandible::new(Parameters {
            chin_deviation: 0.0,
            ..*mandible.parameters()
        })?;
        let tips: Vec<Vec3> = lower.teeth().iter().map(Crown::tip).collect();
        let (front, back) = (tips[0], tips[tips.len() / 2 - 1]);
        let rise = (back.z - front.z) / (back.y - front.y);
        let normal = Vec3::new(0.0, -rise, 1.0).normalize();
        let incisor = Vec3::new(0.0, front.y, front.z);
        // The upper incisors' tip, a chord of the circle about the condyles' axis away.
        let half = 0.5 * lower.parameters().mouth_opening / incisor.norm();
        let angle = 2.0 * half.min(1.0).asin();
        let mut jaw = Self {
            height: normal.dot(&incisor),
            normal,
            turn: angle.sin_cos().into(),
            outline: lower.arch_outline(),
            incisors: [incisor; 2],
            lower,
        };
        jaw.incisors[1] = jaw.opened(&incisor);
        Ok(jaw)
    }

    fn scale(&self) -> f64 {
        self.lower.parameters().scale
    }

    /// The condyles' axis is that of x; the front goes up.
    fn opened(&self, p: &Vec3) -> Vec3 {
        let [sin, cos] = self.turn;
        Vec3::new(p.x, cos * p.y + sin * p.z, cos * p.z - sin * p.y)
    }

    /// The other side of the occlusal plane.
    fn mirrored(&self, p: &Vec3) -> Vec3 {
        p - self.normal * (2.0 * (self.normal.dot(p) - self.height))
    }

    /// The lower crowns, each for itself, in their places opposite.
    fn teeth(&self) -> Result<TriMesh, AnatomyError> {
        let mut all = TriMesh::default();
        for crown in self.lower.teeth() {
            all.append(&crown.surface()?);
        }
        for p in &mut all.vertices {
            *p = self.opened(&self.mirrored(p));
        }
        all.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        Ok(all)
    }

    /// Where a place of the upper jaw lies in the lower one that it mirrors.
    fn in_lower(&self, p: &Vec3) -> Vec3 {
        let [sin, cos] = self.turn;
        let closed = Vec3::new(p.x, cos * p.y - sin * p.z, cos * p.z + sin * p.y);
        self.mirrored(&closed)
    }

    /// Where a box of the lower jaw lies in the upper one.
    fn bounds_of(&self, lower: &Aabb) -> Aabb {
        let corner = |i: usize| {
            let pick = |k: usize| [lower.min[k], lower.max[k]][i >> k & 1];
            self.opened(&self.mirrored(&Vec3::new(pick(0), pick(1), pick(2))))
        };
        Aabb::around(&(0..8).map(corner).collect::<Vec<_>>())
    }
}

/// Alveolar process and palate.
struct Maxilla<'a>(&'a UpperJaw);

impl SignedDistance for Maxilla<'_> {
    fn signed(&self, p: &Vec3) -> f64 {
        let jaw = self.0;
        let (scale, q) = (jaw.scale(), jaw.in_lower(p));
        let [vault, half] = PALATE.map(|c| c * scale);
        let crown = jaw.lower.teeth()[0].kind.mean_size().height * scale;
        let depth = jaw.height - jaw.normal.dot(&q) - crown - vault;
        let within = polygon_distance(&jaw.outline, [q.x, q.y]);
        let palate = rounded(within, depth.abs() - half, 0.8 * half);
        smooth_union(jaw.lower.alveolar_process(&q), palate, 4.0 * scale)
    }

    fn bounds(&self) -> Aabb {
        self.0.bounds_of(&self.0.lower.bounds())
    }
}

/// A ring around the mouth, drawn out to the operated side.
struct Lips {
    ring: Vec<Vec3>,
    radius: f64,
}

impl Lips {
    const ROUND: u32 = 60;

    fn of(jaw: &UpperJaw, side: Side) -> Self {
        let scale = jaw.scale();
        let [low, high] = jaw.incisors;
        let (middle, up) = (0.5 * (low + high), (high - low).normalize());
        let forward = Vec3::x().cross(&up);
        let half_height = 0.5 * (high - low).norm() + 7.0 * scale;
        let at = |k: u32| {
            let angle = f64::from(k) / f64::from(Self::ROUND) * std::f64::consts::TAU;
            let (sin, cos) = angle.sin_cos();
            let out = cos * side.sign();
            let x = cos * scale * if out > 0.0 { MOUTH[1] } else { MOUTH[0] };
            let back = (x / (scale * MOUTH[1])).powi(2);
            let before = scale * (LIPS[0] - LIPS[1] * back);
            middle + Vec3::x() * x + up * (half_height * sin) + forward * before
        };
        Self {
            ring: (0..Self::ROUND).map(at).collect(),
            radius: LIP * scale,
        }
    }
}

impl SignedDistance for Lips {
    fn signed(&self, p: &Vec3) -> f64 {
        let n = self.ring.len();
        let off = |i: usize| {
            let (a, b) = (self.ring[i], self.ring[(i + 1) % n]);
            let along = b - a;
            let share = (p - a).dot(&along) / along.norm_squared();
            (p - a - along * share.clamp(0.0, 1.0)).norm()
        };
        (0..n).map(off).fold(f64::INFINITY, f64::min) - self.radius
    }

    fn bounds(&self) -> Aabb {
        Aabb::around(&self.ring).grown(self.radius)
    }
}

/// A blade between cheek and bone, led out of the mouth beside the chisels.
struct Retractor {
    centre: Vec3,
    axes: [Vec3; 3],
    half: Vec3,
}

impl Retractor {
    fn of(jaw: &UpperJaw, side: Side) -> Self {
        let (scale, sign) = (jaw.scale(), side.sign());
        let out = Vec3::new(0.12 * sign, -0.80, 0.58).normalize();
        let across = Vec3::x() * sign;
        let normal = (across - out * out.dot(&across)).normalize();
        let sizes = jaw.lower.parameters();
        let buccal = 0.5 * sizes.condyle_distance - 5.5 + 0.5 * sizes.ramus_thickness;
        let molar = jaw.lower.teeth()[jaw.lower.teeth().len() / 2 - 1].neck;
        let inner = Vec3::new(
            sign * scale * (buccal + BLADE_OFF),
            molar.y + 8.0 * scale,
            molar.z - 8.0 * scale,
        );
        Self {
            centre: inner + out * (BLADE.z * scale),
            axes: [normal, out.cross(&normal), out],
            half: BLADE * scale,
        }
    }
}

impl SignedDistance for Retractor {
    fn signed(&self, p: &Vec3) -> f64 {
        let d = p - self.centre;
        let outside = Vec3::from_fn(|k, _| self.axes[k].dot(&d).abs() - self.half[k]);
        let side = rounded(outside.x, outside.y, 0.9 * self.half.x);
        rounded(side, outside.z, 0.9 * self.half.x)
    }

    fn bounds(&self) -> Aabb {
        let reach =
            Vec3::from_fn(|k, _| (0..3).map(|a| self.half[a] * self.axes[a][k].abs()).sum());
        Aabb {
            min: self.centre - reach,
            max: self.centre + reach,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ClosedSurface;

    fn jaw(change: impl Fn(&mut Parameters)) -> ParametricMandible {
        let mut parameters = Parameters {
            mouth_opening: 45.0,
            ..Parameters::default()
        };
        change(&mut parameters);
        ParametricMandible::new(parameters).unwrap()
    }

    /// Jaws of all kinds: every surface is closed, and none touches bone or lower teeth.
    #[test]
    fn all_is_closed_and_keeps_clear_of_the_jaw() {
        for (jaw, side) in [
            (jaw(|_| {}), Side::Right),
            (jaw(|p| p.scale = 0.8), Side::Left),
            (jaw(|p| p.scale = 1.2), Side::Right),
            (jaw(|p| p.chin_deviation = 6.0), Side::Right),
            (jaw(|p| p.chin_deviation = 6.0), Side::Left),
            (jaw(|p| p.gonial_angle = 136.0), Side::Left),
        ] {
            for (role, mesh) in around(&jaw, side).unwrap() {
                let closed = ClosedSurface::of_pieces(mesh, &role).unwrap();
                assert!(closed.notes.is_empty(), "{role}: {:?}", closed.notes);
                let vertices = closed.mesh.vertices.iter();
                let near = vertices.map(|p| jaw.signed_with_teeth(p));
                let near = near.fold(f64::INFINITY, f64::min);
                assert!(near > 0.5, "{role}, {:?}: {near} mm", jaw.parameters());
            }
        }
    }

    #[test]
    fn incisors_are_apart_by_the_opening_and_closed_teeth_meet() {
        let jaw = jaw(|_| {});
        let upper = UpperJaw::opposite(&jaw).unwrap();
        let [low, high] = upper.incisors;
        assert!(((high - low).norm() - 45.0).abs() < 1e-9);
        assert!((high.norm() - low.norm()).abs() < 1e-9 && high.z > low.z);
        // Opened and mirrored back, a place of the occlusal plane is itself.
        assert!((upper.in_lower(&high) - low).norm() < 1e-9);
        let meshes = around(&jaw, Side::Right).unwrap();
        let teeth = meshes
            .iter()
            .find(|(role, _)| role == "upper teeth")
            .unwrap();
        let at_midline = teeth
            .1
            .vertices
            .iter()
            .filter(|p| p.x.abs() < 5.0 && p.y < high.y + 8.0);
        let lowest = at_midline.map(|p| p.z).fold(f64::INFINITY, f64::min);
        assert!((lowest - high.z).abs() < 2.5, "{lowest} against {}", high.z);
    }

    #[test]
    fn the_left_is_the_rights_mirror_image() {
        let upper = UpperJaw::opposite(&jaw(|_| {})).unwrap();
        let [right, left] = [Side::Right, Side::Left].map(|s| Lips::of(&upper, s));
        let blades = [Side::Right, Side::Left].map(|s| Retractor::of(&upper, s));
        for p in [Vec3::new(-50.0, -60.0, -10.0), Vec3::new(20.0, -85.0, 3.0)] {
            let mirrored = Vec3::new(-p.x, p.y, p.z);
            assert!((right.signed(&p) - left.signed(&mirrored)).abs() < 1e-9);
            assert!((blades[0].signed(&p) - blades[1].signed(&mirrored)).abs() < 1e-9);
        }
    }
}
