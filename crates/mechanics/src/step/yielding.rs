//! How the tools give way when the bone does: the part of the coupled equations that plain sweeps leave out.
//!
//! A sweep solves the bone under forces that were computed for where it stood. Stiffly held tools against a soft fragment
//! then overshoot more with each sweep. Here each tool's contacts are taken as patches that move with the bone as rigid bodies: one, or
//! one for each of the two sides on which a blade in a slit is pressed. A tool on its coupling and its contacts' springs comes to rest
//! between its patches; as they move, the wrenches on them fall by a stiffness S: S_gh = M_g d_gh - M_g (S_c + sum M)^-1 M_h, with
//! the coupling's stiffness S_c and that of each patch's contacts against a motion of the patch, M_g. With one patch and stiff
//! contacts S is S_c; with two, their springs are against the sides' coming together. With B the unknowns' forces of
//! a unit wrench on each patch, the sweep becomes (K + B S B^T) x = F + B S B^T x_old. By the formula of Sherman, Morrison and
//! Woodbury that is K x = F + B q, with q from the compliance C = B^T K^-1 B, and for C the forward half of a solve is
//! enough. Its fixed point is that of the plain sweep.
use super::bone::Bone;
use crate::bone::{HalfSolved, Swept};
use crate::contact::{Matrix6, Wrench};
use crate::crack::stress_intensity::CellForce;
use crate::geometry::{Pose, Vec3};
use crate::tool::{BoneCompliance, Matrix12, ToolsState};
use nalgebra::{DMatrix, DVector, Matrix3, Matrix6x3, Vector6};
use std::collections::BTreeMap;

/// The tools' yielding in one main step.
#[derive(Debug)]
pub struct Yielding {
    /// The patches: of which tool each is, and how it moves and is pressed with all of that tool's contacts: a wrench on these is
    /// `share` times it on the patch.
    patches: Vec<(usize, Matrix6)>,
    /// Where each tool was.
    origins: [Vec3; 2],
    /// B, column by column: (unknown, value).
    forces: Vec<Vec<(u32, f64)>>,
    half: HalfSolved,
    /// C = B^T K^-1 B.
    compliance: DMatrix<f64>,
    /// (I + S C)^-1 S.
    correction: DMatrix<f64>,
    stiffness: DMatrix<f64>,
}

/// The contacts of one tool and the stiffness of its coupling about its origin.
#[derive(Clone, Debug)]
pub struct Pressed {
    /// Its contacts: deformed position, force on the bone, and how that falls when the point moves \[N/mm\].
    pub contacts: Vec<(Vec3, CellForce, Matrix3<f64>)>,
    /// World from tool.
    pub tool: Pose,
    /// 6 x 6, force and torque against translation and rotation.
    pub stiffness: Matrix6,
}

impl Yielding {
    /// The correction for these contacts; none without contacts.
    pub fn new(bone: &Bone, pressed: &[Pressed; 2]) -> Option<Self> {
        let (mut patches, mut forces, mut stiffnesses) = (Vec::new(), Vec::new(), Vec::new());
        for (t, pressed) in pressed.iter().enumerate() {
            let own = Patch::of(pressed)?;
            let whole: Matrix6 = own.iter().map(|p| p.mass).sum();
            let whole = whole.try_inverse().filter(|_| !own.is_empty());
            for patch in &own {
                patches.push((t, patch.mass * whole?));
                forces.extend(patch.unit_wrenches(bone, pressed)?);
            }
            stiffnesses.push(stiffness(&own, &pressed.stiffness)?);
        }
        if forces.is_empty() {
            return None;
        }
        let m = forces.len();
        let mut stiffness = DMatrix::zeros(m, m);
        let mut first = 0;
        for own in &stiffnesses {
            let n = own.nrows();
            stiffness.view_mut((first, first), (n, n)).copy_from(own);
            first += n;
        }
        let half = bone.system.half_solve(&forces);
        let compliance = DMatrix::from_vec(m, m, half.compliance(&half));
        let system = DMatrix::identity(m, m) + &stiffness * &compliance;
        let correction = system.lu().solve(&stiffness)?;
        let is_sound = correction.iter().all(|v| v.is_finite());
        is_sound.then_some(Self {
            patches,
            origins: [0, 1].map(|t| pressed[t].tool.translation.vector),
            forces,
            half,
            compliance,
            correction,
            stiffness,
        })
    }

    /// Adds B q to what is half solved of all other loads on the way from `before`, so that the sweep down gives the corrected sweep
    /// from `old`.
    pub fn correct(&self, bone: &Bone, before: &[f64], old: &[f64], swept: &mut Swept) {
        let way = DVector::from_vec(bone.system.project(&self.half, swept));
        let free = self.patches(before) + way;
        let pull = &self.stiffness * self.patches(old);
        let q = &pull - &self.correction * (free + &self.compliance * &pull);
        bone.system.add_half(&self.half, q.as_slice(), swept);
    }

    /// Number of columns of B.
    pub fn n_columns(&self) -> usize {
        self.forces.len()
    }

    /// How the patches move by other forces: B^T K^-1 A of half-solved columns A.
    pub fn moved_by(&self, half: &HalfSolved) -> DMatrix<f64> {
        DMatrix::from_vec(
            self.n_columns(),
            half.n_columns(),
            self.half.compliance(half),
        )
    }

    /// By how much the wrenches on the patches fall when they are moved so: (I + S C)^-1 S.
    pub fn given_way(&self, moved: &DMatrix<f64>) -> DMatrix<f64> {
        &self.correction * moved
    }

    /// Adds what the tools give way when other forces move the patches so, after [`correct`](Self::correct).
    pub fn follow(&self, bone: &Bone, moved: &DVector<f64>, swept: &mut Swept) {
        let q = -(&self.correction * moved);
        bone.system.add_half(&self.half, q.as_slice(), swept);
    }

    /// What the haptic loop needs to let the bone yield, about a state in which the tools rest at `tools` and their couplings pull
    /// with `pull` (about the tools' origins).
    pub fn bone_compliance(&self, tools: &ToolsState, pull: &[Wrench; 2]) -> BoneCompliance {
        let mut matrix = Matrix12::zeros();
        for (i, (t, share)) in self.patches.iter().enumerate() {
            for (j, (u, other)) in self.patches.iter().enumerate() {
                let block = self.compliance.fixed_view::<6, 6>(6 * i, 6 * j);
                let mut to = matrix.fixed_view_mut::<6, 6>(6 * t, 6 * u);
                to += share.transpose() * block * other;
            }
        }
        let touches = |t: usize| self.patches.iter().any(|p| p.0 == t);
        let origins = [0, 1].map(|t| match touches(t) {
            true => self.origins[t],
            false => tools.poses[t].translation.vector,
        });
        let load = [0, 1].map(|t| {
            let arm = tools.poses[t].translation.vector - origins[t];
            Wrench {
                force: pull[t].force,
                torque: pull[t].torque + arm.cross(&pull[t].force),
            }
        });
        BoneCompliance {
            matrix,
            origins,
            load,
        }
    }

    /// B^T x: how the patches move when the bone does.
    fn patches(&self, x: &[f64]) -> DVector<f64> {
        let along = |f: &Vec<(u32, f64)>| f.iter().map(|(i, v)| v * x[*i as usize]).sum();
        DVector::from_iterator(self.forces.len(), self.forces.iter().map(along))
    }
}

/// Contacts of a tool that move together.
#[derive(Debug, Default)]
struct Patch {
    /// Which of the tool's contacts.
    contacts: Vec<usize>,
    /// sum w j j^T over them, for motions j of a point by the patch's and weights w by how hard each presses.
    mass: Matrix6,
    /// Their stiffness against a motion of the patch.
    stiffness: Matrix6,
}

/// Keeps a patch of few or collinear points regular: a radius \[mm\] that every contact has at least.
const RADIUS: f64 = 0.5;
/// A coupling softer than this share of all that holds a tool counts as letting it go.
const LEAST_HELD: f64 = 1e-6;
/// A side that bears a smaller share of the force than this is none.
const LEAST_SIDE: f64 = 0.05;

/// How a point's motion follows from that of a body about `origin`, transposed.
fn arm(p: &Vec3, origin: &Vec3) -> Matrix6x3<f64> {
    let mut j = Matrix6x3::zeros();
    j.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
    j.fixed_view_mut::<3, 3>(3, 0)
        .copy_from(&(p - origin).cross_matrix());
    j
}

impl Patch {
    /// The patches of a tool: the two sides that its forces part into, or one; none if nothing presses.
    fn of(pressed: &Pressed) -> Option<Vec<Self>> {
        let total: f64 = pressed.contacts.iter().map(|c| c.1.force.norm()).sum();
        if total <= 0.0 {
            return Some(Vec::new());
        }
        let spread: Matrix3<f64> = (pressed.contacts.iter())
            .map(|c| c.1.force * c.1.force.transpose() / c.1.force.norm().max(1e-12 * total))
            .sum();
        let eigen = spread.symmetric_eigen();
        let axis = eigen
            .eigenvectors
            .column(eigen.eigenvalues.imax())
            .into_owned();
        let origin = pressed.tool.translation.vector;
        let mut sides = [Self::default(), Self::default()];
        let mut shares = [0.0; 2];
        for (i, (p, load, stiffness)) in pressed.contacts.iter().enumerate() {
            let side = usize::from(load.force.dot(&axis) < 0.0);
            let weight = load.force.norm() / total;
            let j = arm(p, &origin);
            sides[side].contacts.push(i);
            sides[side].mass += j * j.transpose() * weight;
            sides[side].stiffness += j * stiffness * j.transpose();
            shares[side] += weight;
        }
        let mut sides: Vec<Self> = if shares.iter().all(|s| *s >= LEAST_SIDE) {
            sides.into()
        } else {
            let [mut one, other] = sides;
            one.contacts.extend(other.contacts);
            one.mass += other.mass;
            one.stiffness += other.stiffness;
            shares = [1.0, 0.0];
            vec![one]
        };
        let radius = Matrix6::from_diagonal(&Vector6::new(0.0, 0.0, 0.0, 1.0, 1.0, 1.0));
        for (side, share) in sides.iter_mut().zip(shares) {
            side.mass += radius * (RADIUS * RADIUS * share);
        }
        Some(sides)
    }

    /// The unknowns' forces of the six unit wrenches on it.
    fn unit_wrenches(&self, bone: &Bone, pressed: &Pressed) -> Option<Vec<Vec<(u32, f64)>>> {
        let total: f64 = pressed.contacts.iter().map(|c| c.1.force.norm()).sum();
        let inverse = self.mass.try_inverse()?;
        let origin = pressed.tool.translation.vector;
        // Contacts are many, cells few: summed by cell and corner before the unknowns are looked up.
        let mut corners: BTreeMap<u32, [Matrix6x3<f64>; 4]> = BTreeMap::new();
        for i in &self.contacts {
            let (p, load, _) = &pressed.contacts[*i];
            let row = inverse * arm(p, &origin) * (load.force.norm() / total);
            let cell = corners.entry(load.cell).or_default();
            for (sum, w) in cell.iter_mut().zip(load.weights) {
                *sum += row * w;
            }
        }
        let mesh = &bone.body.mesh;
        let mut columns = vec![Vec::new(); 6];
        for (cell, rows) in &corners {
            let cell = &bone.topology.cells()[*cell as usize];
            for (k, column) in columns.iter_mut().enumerate() {
                let forces = rows.each_ref().map(|r| r.row(k).transpose());
                bone.system.push_corner_forces(mesh, cell, &forces, column);
            }
        }
        Some(columns)
    }
}

/// How the wrenches on a tool's patches fall as these move, the tool at rest between them and its coupling.
fn stiffness(patches: &[Patch], coupling: &Matrix6) -> Option<DMatrix<f64>> {
    let n = patches.len();
    let mut all = DMatrix::zeros(6 * n, 6 * n);
    if n == 0 {
        return Some(all);
    }
    let mut held: Matrix6 = patches.iter().map(|p| p.stiffness).sum::<Matrix6>() + coupling;
    let scale = held.trace() / 6.0;
    if coupling.diagonal().min() < LEAST_HELD * scale {
        // Saturated, it may leave a direction free in which no contact holds the tool either: a wrench along it is on no patch.
        held += Matrix6::from_diagonal_element(1e-3 * LEAST_HELD * scale);
    }
    let inverse = held.try_inverse()?;
    for (g, patch) in patches.iter().enumerate() {
        for (h, other) in patches.iter().enumerate() {
            let mut block = -(patch.stiffness * inverse * other.stiffness);
            if g == h {
                block += patch.stiffness;
            }
            all.fixed_view_mut::<6, 6>(6 * g, 6 * h).copy_from(&block);
        }
    }
    Some(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pressed(contacts: &[(Vec3, Vec3)]) -> Pressed {
        let contact = |(p, force): &(Vec3, Vec3)| {
            let load = CellForce {
                cell: 0,
                weights: [0.25; 4],
                force: *force,
            };
            let out = force.normalize();
            (*p, load, out * out.transpose() * 40.0)
        };
        Pressed {
            contacts: contacts.iter().map(contact).collect(),
            tool: Pose::identity(),
            stiffness: Matrix6::from_diagonal_element(80.0),
        }
    }

    /// A blade in a slit is pressed from two sides; pressed from one, or hardly from the other, its contacts are one patch.
    #[test]
    fn a_blade_in_a_slit_has_two_patches() {
        let at = |k: f64, side: f64| (Vec3::new(k, side, 0.1 * k), Vec3::y() * (side * (3.0 + k)));
        let side = |sign: f64| (0..5).map(move |k| at(f64::from(k), sign));
        let both: Vec<_> = side(1.0).chain(side(-1.0)).collect();
        let patches = Patch::of(&pressed(&both)).unwrap();
        let mut sizes = patches.iter().map(|p| p.contacts.len());
        assert!(patches.len() == 2 && sizes.all(|n| n == 5));
        let one: Vec<_> = side(1.0)
            .chain([(Vec3::zeros(), Vec3::y() * -0.1)])
            .collect();
        let patches = Patch::of(&pressed(&one)).unwrap();
        assert_eq!((patches.len(), patches[0].contacts.len()), (1, 6));
        assert!(Patch::of(&pressed(&[])).unwrap().is_empty());
    }

    /// Springs of both sides in a row with the coupling: moved together the sides feel the coupling, towards each other their contacts.
    #[test]
    fn sides_that_close_in_on_a_blade_are_pushed_apart() {
        let patch = || Patch {
            stiffness: Matrix6::from_diagonal_element(1000.0),
            ..Default::default()
        };
        let coupling = Matrix6::from_diagonal_element(80.0);
        let s = stiffness(&[patch(), patch()], &coupling).unwrap();
        let force = |a: f64, b: f64| s[(0, 0)] * a + s[(0, 6)] * b;
        // Half of it each: two springs of 1000 beside each other, in a row with 80.
        let together = 0.5 * 2000.0 * 80.0 / 2080.0;
        assert!((force(1.0, 1.0) - together).abs() < 1e-9);
        assert!((force(1.0, -1.0) - 1000.0).abs() < 1e-9);
        let alone = stiffness(&[patch()], &coupling).unwrap();
        assert!((alone[(0, 0)] - 1000.0 * 80.0 / 1080.0).abs() < 1e-9);
        // A coupling that gives no more: a side that is pressed by itself carries the tool along.
        let mut flat = patch();
        flat.stiffness[(1, 1)] = 0.0;
        let free = stiffness(&[flat], &Matrix6::zeros()).unwrap();
        assert!(free.amax() < 1e-3, "{free}");
    }
}
