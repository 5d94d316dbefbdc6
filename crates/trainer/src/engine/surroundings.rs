//! What stands still around the jaw: surfaces of a scenario as distance fields for contact.
use crate::scenario::Context as Surface;
use anyhow::Result;
use osteotome_anatomy::ClosedSurface;
use osteotome_anatomy::input::read_surface;
use osteotome_mechanics::geometry::{Aabb, DistanceGrid, MeshDistance, TriMesh, Vec3};
use std::sync::Arc;

/// Of the samples of a field \[mm\]: blades are broad.
const SPACING: f64 = 1.0;
/// How taut soft tissue pushes back: pressure over the cube of the depth \[MPa/mm3\]. Assumed: a square centimetre of a blade takes 5 N at
/// 1 mm and 320 N at 4 mm, so that a pulled lip gives way a little and then stops it.
const SOFT: f64 = 0.05;
/// What is soft, by words of its role, unless it is an instrument.
const SOFT_ROLES: [&str; 10] = [
    "lip",
    "cheek",
    "skin",
    "tissue",
    "gingiva",
    "mucosa",
    "muscle",
    "masseter",
    "pterygoid",
    "tongue",
];
const INSTRUMENTS: [&str; 3] = ["retractor", "hook", "instrument"];
/// Farther from the osteotomy line than this \[mm\] no blade touches anything.
const REACH: f64 = 60.0;

/// One surface around the jaw.
#[derive(Clone, Debug)]
pub struct Surrounding {
    /// What it is.
    pub role: String,
    /// Its surface, to be seen.
    pub mesh: TriMesh,
    /// To be touched; none if the surface is open or out of the blades' reach.
    pub field: Option<Arc<DistanceGrid>>,
}

/// Reads the surfaces; `came_with`: those of the patient's folder. An open one is left out of contact, and `notes` says so.
/// `stiffness`: that of the contact law \[MPa/mm\], which soft ones fall short of.
///
/// # Errors
/// One line for a file that cannot be read.
pub fn surroundings(
    given: &[Surface],
    came_with: Vec<(String, TriMesh)>,
    line: impl Iterator<Item = Vec3>,
    stiffness: f64,
    notes: &mut Vec<String>,
) -> Result<Vec<Surrounding>> {
    let line: Vec<Vec3> = line.collect();
    let near = Aabb::around(&line).grown(REACH);
    let mut make = |role: String, mesh: TriMesh, name: String| -> Result<Surrounding> {
        let field = match ClosedSurface::of_pieces(mesh.clone(), &name) {
            Ok(closed) => {
                notes.extend(closed.notes);
                let soft = is_soft(&role).then(|| give(stiffness));
                field(closed.mesh, &near, soft)?
            }
            Err(why) => {
                notes.push(format!("{why}; it is shown, but tools do not touch it"));
                None
            }
        };
        Ok(Surrounding { role, mesh, field })
    };
    let mut all = Vec::new();
    for (role, mesh) in came_with {
        let name = format!("the patient's {role}");
        all.push(make(role, mesh, name)?);
    }
    for s in given {
        let mesh = read_surface(&s.surface)?;
        all.push(make(s.role.clone(), mesh, s.surface.display().to_string())?);
    }
    Ok(all)
}

fn is_soft(role: &str) -> bool {
    let role = role.to_lowercase();
    let is = |words: &[&str]| words.iter().any(|w| role.contains(w));
    is(&SOFT_ROLES) && !is(&INSTRUMENTS)
}

/// What the square of a depth is multiplied by, so that a contact law of this stiffness makes soft tissue's pressure of it: it takes a
/// field `f` for a distance, its energy is `k f^2 / 2` an area, and of `f = g d^2` the pressure is `2 k g^2 d^3`.
fn give(stiffness: f64) -> f64 {
    (0.5 * SOFT / stiffness).sqrt()
}

fn field(mesh: TriMesh, near: &Aabb, soft: Option<f64>) -> Result<Option<Arc<DistanceGrid>>> {
    let own = Aabb::around(&mesh.vertices).grown(2.0 * SPACING);
    let bounds = Aabb {
        min: own.min.sup(&near.min),
        max: own.max.inf(&near.max),
    };
    if bounds.extent().min() <= SPACING {
        return Ok(None);
    }
    let distance = MeshDistance::new(mesh);
    // Likewise outside, lest the field have a kink where it is touched.
    let felt = |d: f64| soft.map_or(d, |give| give * d * d.abs());
    let grid = DistanceGrid::sample(bounds, [SPACING; 3], |p| felt(distance.signed(p)))?;
    Ok(Some(Arc::new(grid)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use osteotome_mechanics::contact::{ContactLaw, PairResponse, add_static};
    use osteotome_mechanics::geometry::Pose;
    use osteotome_mechanics::tool::{Chisel, ChiselParameters};

    /// A blade pressed flat onto a slab `depth` deep: the force that lifts it, and the energy.
    fn pressed(role: &str, depth: f64) -> (f64, f64) {
        let (low, high) = (Vec3::new(-40.0, -20.0, -80.0), Vec3::new(40.0, 0.0, 20.0));
        let block = osteotome_mechanics::geometry::block_mesh(low, high, [4, 2, 4]);
        let slab = TriMesh {
            vertices: block.nodes().to_vec(),
            triangles: block.boundary_faces().to_vec(),
        };
        let line = [Vec3::zeros()];
        let law = ContactLaw::new(4000.0, 0.3).unwrap();
        let around = vec![(role.to_owned(), slab)];
        let made = surroundings(&[], around, line.into_iter(), 4000.0, &mut Vec::new()).unwrap();
        let fields: Vec<_> = made.into_iter().filter_map(|s| s.field).collect();
        let chisel = Chisel::new(ChiselParameters {
            width: 6.0,
            thickness: 2.0,
            bevel_deg: 8.0,
            length: 60.0,
        });
        let shape = chisel.unwrap().shape();
        let above = |y: f64| Pose::translation(0.0, y, 0.0);
        let mut response = PairResponse::NONE;
        let poses = [above(1.0 - depth), above(50.0)];
        add_static(&mut response, [&shape, &shape], &poses, &fields, &law);
        (response.wrenches[0].force.y, response.energy)
    }

    /// Pressure of a flat blade against the law, and force against the energy's slope; of an instrument that of bone.
    #[test]
    fn lips_give_way_and_then_stop_a_blade() {
        const STEP: f64 = 0.02;
        let mut last = 0.0;
        // Between the planes of the field's lattice: its slope jumps there.
        for depth in [1.5, 2.5, 4.5] {
            let [(_, below), (force, _), (_, above)] =
                [depth - STEP, depth, depth + STEP].map(|d| pressed("lips", d));
            let slope = (above - below) / (2.0 * STEP);
            assert!(
                (force / slope - 1.0).abs() < 0.05,
                "{depth} mm: {force} N, {slope} N"
            );
            assert!(force > 4.0 * last, "{depth} mm: {force} N after {last} N");
            last = force;
        }
        let [little, deep] = [1.5, 4.5].map(|d| pressed("lips", d).0);
        // A side of the blade has 360 mm2 less its bevel; its other side and its ends lie deep, too, from 2 mm on.
        assert!((30.0..120.0).contains(&little), "{little} N");
        assert!(deep > 500.0, "{deep} N");
        let hard = pressed("cheek retractor", 1.5).0;
        assert!(hard > 1_000.0 * little, "{hard} N");
    }
}
