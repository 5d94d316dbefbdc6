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
/// Half of the open mouth's width where nothing pulls, and how far beyond the incisors the lips lie above and below \[mm at scale 1\].
const MOUTH: f64 = 32.0;
const LIPS_OFF: f64 = 7.0;
/// The lips lie before the incisors by so much \[mm at scale 1\], and recede with the square of the distance from the midline
/// \[1/mm at scale 1\]: by 30 mm at 58 mm.
const LIPS: [f64; 2] = [13.0, 0.009];
/// Between a blade's edge and the lip as the retractor holds it, and half of a blade's width; not of the jaw's scale \[mm\].
const ROOM: f64 = 10.0;
const HALF_BLADE: f64 = 3.0;
/// Each brings the place where a way passes the face four times nearer, at least.
const STEPS: u32 = 30;
/// Half of the retractor's blade: thickness, width, length \[mm at scale 1\].
const BLADE: Vec3 = Vec3::new(1.2, 11.0, 36.0);
/// Between the retractor and a blade's edge, and how far out of the ridge its inner end lies \[mm\].
const BLADE_OFF: f64 = 5.0;
const BLADE_OUT: f64 = 6.0;

/// Each surface with what it is, around a mandible that is operated on the given side.
///
/// # Errors
/// As [`mesher::contour`].
pub fn around(
    mandible: &ParametricMandible,
    side: Side,
) -> Result<Vec<(String, TriMesh)>, AnatomyError> {
    let upper = UpperJaw::opposite(mandible)?;
    let way = Way::of(mandible, side);
    let parts: [(&str, &dyn SignedDistance); 3] = [
        ("maxilla", &Maxilla(&upper)),
        ("lips", &Lips::of(mandible, &upper, &way)),
        ("retractor", &Retractor::of(&way, upper.scale())),
    ];
    let mut all = vec![("upper teeth".to_owned(), upper.teeth()?)];
    for (role, part) in parts {
        // A thin plate frays on a coarse lattice.
        let spacing = if role == "retractor" {
            0.5 * SPACING
        } else {
            SPACING
        };
        all.push((role.to_owned(), mesher::contour(part, spacing)?));
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

/// The way of the chisels: a flat band from the ridge out of the mouth.
struct Way {
    /// Its two ends on the ridge \[mm\].
    ridge: [Vec3; 2],
    /// Unit vector, square to the ridge.
    out: Vec3,
    /// Sign of x of the operated side.
    side: f64,
}

impl Way {
    /// Places on the ridge by which the lips are laid.
    const STATIONS: u32 = 6;

    fn of(mandible: &ParametricMandible, side: Side) -> Self {
        let ridge = mandible.ridge_ends(side);
        let along = (ridge[1] - ridge[0]).normalize();
        let out = outward(side);
        Self {
            ridge,
            out: (out - along * along.dot(&out)).normalize(),
            side: side.sign(),
        }
    }

    fn stations(&self) -> impl Iterator<Item = Vec3> {
        let [a, b] = self.ridge;
        (0..=Self::STATIONS).map(move |k| a.lerp(&b, f64::from(k) / f64::from(Self::STATIONS)))
    }

    /// The place on the band that is nearest.
    fn nearest(&self, p: &Vec3) -> Vec3 {
        let [a, along] = [self.ridge[0], self.ridge[1] - self.ridge[0]];
        let share = ((p - a).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
        a + along * share + self.out * (p - a).dot(&self.out).max(0.0)
    }
}

/// Whither shafts and retractor lead out of the mouth.
fn outward(side: Side) -> Vec3 {
    Vec3::new(0.12 * side.sign(), -0.80, 0.58).normalize()
}

/// The lips: as a taut band they go straight from what holds them to what holds them, and that is the mouth as it is open by itself, and on
/// the operated side the room that the retractor makes about the chisels' way.
struct Lips {
    ring: Vec<Vec3>,
    radius: f64,
}

impl Lips {
    const ROUND: u32 = 72;
    /// Points about each place that the lips are held at.
    const HELD: u32 = 16;

    fn of(mandible: &ParametricMandible, jaw: &UpperJaw, way: &Way) -> Self {
        let scale = jaw.scale();
        let [low, high] = jaw.incisors;
        let (middle, up) = (0.5 * (low + high), (high - low).normalize());
        let forward = Vec3::x().cross(&up);
        let (radius, mouth) = (LIP * scale, MOUTH * scale);
        let clear = radius + HALF_BLADE + ROOM;
        // The face: lips lie on it, it recedes sidewards.
        let face = |x: f64| scale * LIPS[0] - LIPS[1] * x * x / scale;
        let opening = [mouth, 0.5 * (high - low).norm() + LIPS_OFF * scale];
        let mut held = ellipse([0.0, 0.0], opening, Self::ROUND);
        for station in way.stations() {
            let mut passing = station - middle;
            for _ in 0..STEPS {
                let before = passing.dot(&forward) - face(passing.x);
                passing -= way.out * before;
            }
            // The way passes the face aslant.
            let room = [1.1 * clear, 1.4 * clear];
            held.extend(ellipse([passing.x, passing.dot(&up)], room, Self::HELD));
        }
        let on_face = |[x, z]: [f64; 2]| middle + Vec3::x() * x + up * z + forward * face(x);
        let free = |p: Vec3| {
            let nearest = way.nearest(&p);
            let away = p - nearest;
            let lack = clear - away.norm();
            p + away.normalize() * lack.max(0.0)
        };
        // The jaw may stand out farther than the face here is thought to: lips lie before it.
        let before_jaw = |mut p: Vec3| {
            for _ in 0..STEPS {
                p += forward * (radius + 1.0 - mandible.signed_with_teeth(&p)).max(0.0);
            }
            p
        };
        // The left is cut as the right's mirror image.
        let turned = |[x, z]: [f64; 2]| [way.side * x, z];
        let held = held.into_iter().map(turned).collect();
        let ring = evenly(&hull(held), Self::ROUND).into_iter().map(turned);
        Self {
            ring: ring.map(on_face).map(free).map(before_jaw).collect(),
            radius,
        }
    }
}

fn ellipse(middle: [f64; 2], half: [f64; 2], n: u32) -> Vec<[f64; 2]> {
    let at = |k: u32| {
        let (sin, cos) = (f64::from(k) / f64::from(n) * std::f64::consts::TAU).sin_cos();
        [middle[0] + half[0] * cos, middle[1] + half[1] * sin]
    };
    (0..n).map(at).collect()
}

/// The convex hull, counter-clockwise (Andrew's monotone chain).
fn hull(mut points: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let turn = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
        (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    };
    let half = |points: &mut dyn Iterator<Item = [f64; 2]>| {
        let mut chain: Vec<[f64; 2]> = Vec::new();
        for p in points {
            while chain.len() > 1 && turn(chain[chain.len() - 2], chain[chain.len() - 1], p) <= 0.0
            {
                chain.pop();
            }
            chain.push(p);
        }
        chain.pop();
        chain
    };
    let mut all = half(&mut points.iter().copied());
    all.extend(half(&mut points.iter().rev().copied()));
    all
}

/// So many points, evenly along a closed polygon.
fn evenly(polygon: &[[f64; 2]], n: u32) -> Vec<[f64; 2]> {
    let next = |i: usize| polygon[(i + 1) % polygon.len()];
    let length = |i: usize| (next(i)[0] - polygon[i][0]).hypot(next(i)[1] - polygon[i][1]);
    let all: f64 = (0..polygon.len()).map(length).sum();
    let (mut edge, mut before) = (0, 0.0);
    let at = |k: u32| {
        let along = all * f64::from(k) / f64::from(n);
        while edge + 1 < polygon.len() && before + length(edge) < along {
            before += length(edge);
            edge += 1;
        }
        let share = (along - before) / length(edge);
        [0, 1].map(|c| polygon[edge][c] + share * (next(edge)[c] - polygon[edge][c]))
    };
    (0..n).map(at).collect()
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
    fn of(way: &Way, scale: f64) -> Self {
        let half = BLADE * scale;
        let [a, b] = way.ridge;
        let across = (b - a).cross(&way.out).normalize();
        let normal = across * (across.x * way.side).signum();
        let beside = normal * (HALF_BLADE + BLADE_OFF + half.x);
        Self {
            centre: 0.5 * (a + b) + beside + way.out * (BLADE_OUT + half.z),
            axes: [normal, way.out.cross(&normal), way.out],
            half,
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

    fn jaws() -> [(ParametricMandible, Side); 8] {
        [
            (jaw(|_| {}), Side::Right),
            (jaw(|p| p.scale = 0.8), Side::Left),
            (jaw(|p| p.scale = 1.2), Side::Right),
            (jaw(|p| p.chin_deviation = 6.0), Side::Right),
            (jaw(|p| p.chin_deviation = 6.0), Side::Left),
            (jaw(|p| p.gonial_angle = 136.0), Side::Left),
            (jaw(|p| p.mouth_opening = 30.0), Side::Right),
            (jaw(|p| p.ramus_thickness = 6.0), Side::Left),
        ]
    }

    /// Jaws of all kinds: every surface is closed, and none touches bone or lower teeth.
    #[test]
    fn all_is_closed_and_keeps_clear_of_the_jaw() {
        for (jaw, side) in jaws() {
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

    /// The lips go round the chisels' way, wider than a blade, and round the retractor that pulls them, no farther out than it takes.
    #[test]
    fn lips_and_retractor_leave_the_way_free() {
        for (jaw, side) in jaws() {
            let upper = UpperJaw::opposite(&jaw).unwrap();
            let way = Way::of(&jaw, side);
            let lips = Lips::of(&jaw, &upper, &way);
            let blade = Retractor::of(&way, upper.scale());
            let mut room = [f64::INFINITY; 2];
            for station in way.stations() {
                for k in 0..50 {
                    let p = station + way.out * (2.0 * f64::from(k));
                    room[0] = room[0].min(lips.signed(&p));
                    room[1] = room[1].min(blade.signed(&p));
                }
            }
            let name = format!("{:?} {side:?}: {room:?}", jaw.parameters());
            assert!(
                (HALF_BLADE + 3.0..HALF_BLADE + ROOM + 1.0).contains(&room[0]),
                "{name}"
            );
            assert!(
                (HALF_BLADE + 3.0..HALF_BLADE + BLADE_OFF + 0.1).contains(&room[1]),
                "{name}"
            );
            // What pulls lies within what is pulled.
            for k in -8..=8 {
                for across in [-1.0, 0.0, 1.0] {
                    let along = Vec3::new(1.0, across, f64::from(k) / 8.0);
                    let face = along.component_mul(&blade.half);
                    let p = blade.centre + (0..3).map(|a| blade.axes[a] * face[a]).sum::<Vec3>();
                    assert!(
                        lips.signed(&p) > 0.2,
                        "{name}: {} mm at {face}",
                        lips.signed(&p)
                    );
                }
            }
        }
    }

    #[test]
    fn a_hull_goes_round_its_points_and_is_cut_evenly() {
        let square = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]];
        let mut points = square.to_vec();
        points.extend([[1.0, 1.0], [0.5, 1.9], [1.0, 0.0]]);
        assert_eq!(hull(points), square);
        let cut = evenly(&square, 8);
        let edges = (0..8).map(|i| {
            let (a, b) = (cut[i], cut[(i + 1) % 8]);
            (b[0] - a[0]).hypot(b[1] - a[1])
        });
        assert!(
            edges.into_iter().all(|e| (e - 1.0).abs() < 1e-12),
            "{cut:?}"
        );
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
        let jaw = jaw(|_| {});
        let upper = UpperJaw::opposite(&jaw).unwrap();
        let [right, left] =
            [Side::Right, Side::Left].map(|s| Lips::of(&jaw, &upper, &Way::of(&jaw, s)));
        let blades = [Side::Right, Side::Left].map(|s| Retractor::of(&Way::of(&jaw, s), 1.0));
        for p in [Vec3::new(-50.0, -60.0, -10.0), Vec3::new(20.0, -85.0, 3.0)] {
            let mirrored = Vec3::new(-p.x, p.y, p.z);
            assert!((right.signed(&p) - left.signed(&mirrored)).abs() < 1e-9);
            assert!((blades[0].signed(&p) - blades[1].signed(&mirrored)).abs() < 1e-9);
        }
    }
}
