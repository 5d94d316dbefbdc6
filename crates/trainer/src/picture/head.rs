//! What stands around the jaw: surfaces that came with the patient, and a schematic head in procedure pose, so that one sees from
//! where the chisels can come. The schematic parts are drawn only; tools do not touch them.
use super::look;
use super::props::{Prop, tube};
use crate::engine::{Prepared, Surrounding};
use osteotome_anatomy::Tooth;
use osteotome_mechanics::geometry::{TriMesh, Vec3};
use osteotome_render::Material;

/// The patient's own surfaces.
pub fn surroundings(prepared: &Prepared) -> Vec<Prop> {
    let one = |s: &Surrounding| Prop::surface(material(&s.role), &s.mesh);
    prepared.surroundings.iter().map(one).collect()
}

fn material(role: &str) -> Material {
    let role = role.to_lowercase();
    let is = |words: &[&str]| words.iter().any(|w| role.contains(w));
    if is(&["teeth", "tooth"]) {
        look::TOOTH
    } else if is(&["retractor", "hook", "instrument"]) {
        look::RETRACTOR
    } else if is(&["skin", "lip"]) {
        look::SKIN
    } else if is(&[
        "tissue",
        "gingiva",
        "mucosa",
        "muscle",
        "masseter",
        "pterygoid",
    ]) {
        look::MUCOSA
    } else {
        look::AROUND
    }
}

/// The open mouth, in the plane of the face: x to the left, z up.
struct Mouth {
    centre: Vec3,
    /// Sign of x of the operated side.
    side: f64,
}

/// Half width and half height of the open mouth \[mm\].
const MOUTH: [f64; 2] = [27.0, 27.0];
/// How far a retractor pulls the corner of the mouth aside and back \[mm\].
const PULLED: [f64; 2] = [26.0, 40.0];
/// The radius of a lip \[mm\].
const LIP: f64 = 5.5;
/// The jaw is open by so much between the teeth \[mm\].
const OPEN: f64 = 26.0;
/// Points around the mouth.
const ROUND: u32 = 72;

impl Mouth {
    fn of(prepared: &Prepared) -> Self {
        let bounds = prepared.patient.surface.bounds();
        let is_front = |p: &&Vec3| p.y < bounds.min.y + 25.0;
        let front = prepared.patient.surface.vertices.iter().filter(is_front);
        let top = front.map(|p| p.z).fold(bounds.min.z, f64::max);
        Self {
            centre: Vec3::new(
                0.5 * (bounds.min.x + bounds.max.x),
                bounds.min.y - 16.0,
                top + 15.0,
            ),
            side: prepared.patient.osteotomy.side.sign(),
        }
    }

    /// A point of the face: `angle` from the patient's left upward, `out` 1 on the lips and more outside of them.
    fn face(&self, angle: f64, out: f64) -> Vec3 {
        let (s, c) = angle.sin_cos();
        let (x, z) = (MOUTH[0] * c * out, MOUTH[1] * s * out);
        // How much of the pull reaches here.
        let pull = (0.5 + 0.5 * c * self.side).powi(2) / out;
        // Cheeks lie back, more so the farther they are out.
        let back = x * x / 105.0 + z * z / 600.0;
        self.centre + Vec3::new(x + PULLED[0] * pull * self.side, back + PULLED[1] * pull, z)
    }
}

/// A schematic head: lips, the skin around them, a cheek retractor, and the upper teeth.
pub fn schematic(prepared: &Prepared) -> Vec<Prop> {
    let mouth = Mouth::of(prepared);
    let mut head = vec![lips(&mouth), skin(&mouth), retractor(&mouth)];
    head.extend(upper_teeth(&prepared.patient.teeth));
    head
}

/// Where the mouth is pulled: there the bar of the lips begins and ends, behind the retractor.
fn corner(mouth: &Mouth) -> f64 {
    match mouth.side > 0.0 {
        true => 0.0,
        false => std::f64::consts::PI,
    }
}

fn lips(mouth: &Mouth) -> Prop {
    let start = corner(mouth);
    let angle = |k: u32| start + f64::from(k) / f64::from(ROUND) * std::f64::consts::TAU;
    let ring = |k: u32| {
        let thinner = 1.0 - 0.35 * angle(k).cos().powi(4);
        (mouth.face(angle(k), 1.0) + Vec3::y() * 1.5, LIP * thinner)
    };
    tube(look::LIP, &(0..=ROUND).map(ring).collect::<Vec<_>>())
}

fn skin(mouth: &Mouth) -> Prop {
    const RINGS: u32 = 14;
    let mut mesh = TriMesh::default();
    for ring in 0..=RINGS {
        let share = f64::from(ring) / f64::from(RINGS);
        let out = 1.0 + 1.75 * share;
        for k in 0..ROUND {
            let angle = f64::from(k) / f64::from(ROUND) * std::f64::consts::TAU;
            mesh.vertices.push(mouth.face(angle, out));
        }
    }
    for ring in 0..RINGS {
        for k in 0..ROUND {
            let [a, b] = [ring * ROUND + k, ring * ROUND + (k + 1) % ROUND];
            mesh.triangles
                .extend([[a, b, b + ROUND], [a, b + ROUND, a + ROUND]]);
        }
    }
    Prop::surface(look::SKIN, &mesh)
}

/// A bent blade of steel behind the pulled corner of the mouth, led outwards.
fn retractor(mouth: &Mouth) -> Prop {
    const WIDTH: f64 = 16.0;
    const THICK: f64 = 1.4;
    let corner = mouth.face(corner(mouth), 1.0);
    let out = Vec3::x() * mouth.side;
    // From within the cheek, round the corner, away to the side and forward.
    let path = [
        corner - out * 3.0 + Vec3::y() * 42.0,
        corner - out * 5.0 + Vec3::y() * 20.0,
        corner - out * 6.5 + Vec3::y() * 4.0,
        corner - out * 3.0 - Vec3::y() * 8.0,
        corner + out * 12.0 - Vec3::y() * 13.0,
        corner + out * 55.0 - Vec3::y() * 16.0,
        corner + out * 105.0 - Vec3::y() * 18.0,
    ];
    let mut mesh = TriMesh::default();
    for k in 0..path.len() {
        let way = path[(k + 1).min(path.len() - 1)] - path[k.saturating_sub(1)];
        let normal = Vec3::z().cross(&way).normalize() * (0.5 * THICK);
        let half = Vec3::z() * (0.5 * WIDTH);
        let at = path[k];
        mesh.vertices.extend([
            at - half - normal,
            at + half - normal,
            at + half + normal,
            at - half + normal,
        ]);
    }
    for k in 0..path.len() as u32 - 1 {
        for c in 0..4u32 {
            let (a, b) = (4 * k + c, 4 * k + (c + 1) % 4);
            mesh.triangles.extend([[a, b, b + 4], [a, b + 4, a + 4]]);
        }
    }
    let last = 4 * (path.len() as u32 - 1);
    mesh.triangles.extend([[0, 2, 1], [0, 3, 2]]);
    mesh.triangles
        .extend([[last, last + 1, last + 2], [last, last + 2, last + 3]]);
    Prop::flat(look::RETRACTOR, &mesh)
}

/// The lower crowns mirrored, opposite the open jaw.
fn upper_teeth(teeth: &[Tooth]) -> Vec<Prop> {
    let tops = teeth.iter().map(|t| t.surface.bounds().max.z);
    let plane = tops.fold(f64::NEG_INFINITY, f64::max) + 0.5 * OPEN;
    let mirrored = |t: &Tooth| {
        let mut mesh = t.surface.clone();
        mesh.vertices
            .iter_mut()
            .for_each(|p| p.z = 2.0 * plane - p.z);
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        Prop::surface(look::TOOTH, &mesh)
    };
    teeth.iter().map(mirrored).collect()
}
