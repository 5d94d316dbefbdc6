//! What a growth costs, and the full method in its place.
use super::least_ms;
use crate::bench::rows::{Part, Row};
use crate::bench::times::{Pairs, Times};
use crate::engine::cut_since;
use anyhow::{Result, ensure};
use osteotome_mechanics::bone::Factor;
use osteotome_mechanics::crack::{System, Topology};
use osteotome_mechanics::step::Bone;

/// All looks at the fronts, and the growths among them.
pub struct Growths {
    step: Times,
    crack: Times,
    linearisation: Times,
    factorisation: Times,
    assembled: Pairs,
    factored: Pairs,
}

impl Default for Growths {
    fn default() -> Self {
        Self {
            step: Times::default(),
            crack: Times::default(),
            linearisation: Times::default(),
            factorisation: Times::default(),
            assembled: Pairs::new("the stiffness of the whole bone"),
            factored: Pairs::new("ordering, analysis and factor of the whole stiffness"),
        }
    }
}

/// The equations of a growth made anew, in two parts \[ms\].
struct Equations {
    linearisation: f64,
    factorisation: f64,
}

impl Equations {
    fn sum(&self) -> f64 {
        self.linearisation + self.factorisation
    }
}

impl Growths {
    /// A look that left the crack as it is.
    pub fn looked(&mut self, ms: f64) {
        self.step.push(ms);
        self.crack.push(ms);
    }

    /// A look that took `ms` and led from one bone to the next.
    ///
    /// # Errors
    /// A stage that cannot be repeated, or a baseline that gives another solution.
    pub fn grew(&mut self, ms: f64, old: &Bone, new: &Bone) -> Result<()> {
        let ours = appended(old, new)?;
        self.step.push(ms);
        self.crack.push((ms - ours.sum()).max(0.0));
        self.linearisation.push(ours.linearisation);
        self.factorisation.push(ours.factorisation);
        if self.factored.is_open() {
            let (full, system) = whole(new)?;
            check(&new.system, &system)?;
            let (one, other) = (full.linearisation, full.factorisation);
            self.assembled.push(ours.linearisation, one, one);
            self.factored.push(ours.factorisation, other, full.sum());
        }
        Ok(())
    }

    /// The rows.
    pub fn rows(self) -> [Row; 4] {
        [
            Row::new(Part::PropagationStep, self.step),
            Row::new(Part::CrackPropagation, self.crack),
            Row::new(Part::Linearisation, self.linearisation).against(self.assembled),
            Row::new(Part::Factorisation, self.factorisation).against(self.factored),
        ]
    }
}

/// The equations of `new` by appending to those of `old`, as the propagation step does it.
fn appended(old: &Bone, new: &Bone) -> Result<Equations> {
    let solid = &old.body.solid;
    let (mesh, materials, supports) = (&solid.mesh, &solid.materials, &solid.supports);
    let (newly_cut, _) = cut_since(&new.cuts, &old.cuts, mesh.edges().len() as u32);
    let newly_cut: Vec<u32> = newly_cut.iter().map(|c| c.0).collect();
    let topology: Topology = old.topology.grown(mesh, &new.cuts, &newly_cut);
    let (grown, both) = least_ms(|| old.system.grown(mesh, materials, &topology, supports));
    let rows = grown?.last_rows();
    let (factor, factorisation) = least_ms(|| old.system.factor().grown(&rows));
    factor?;
    Ok(Equations {
        linearisation: (both - factorisation).max(0.0),
        factorisation,
    })
}

/// The equations of `bone` from nothing: what the paper does after each growth.
fn whole(bone: &Bone) -> Result<(Equations, System)> {
    let solid = &bone.body.solid;
    let (mesh, materials, supports) = (&solid.mesh, &solid.materials, &solid.supports);
    let (system, both) = least_ms(|| System::new(mesh, materials, &bone.topology, supports));
    let system = system?;
    let (matrix, positions) = system.base(mesh, &bone.topology);
    let (factor, factorisation) = least_ms(|| Factor::new(&matrix, &positions));
    factor?;
    let equations = Equations {
        linearisation: (both - factorisation).max(0.0),
        factorisation,
    };
    Ok((equations, system))
}

/// Both solve the same load alike: to 1e-6 of the largest displacement, since soft springs alone hold a loose piece.
fn check(ours: &System, full: &System) -> Result<()> {
    let solve = |s: &System| {
        let mut x: Vec<f64> = (0..s.n()).map(|i| (0.37 * i as f64).sin()).collect();
        s.solve(&mut x, &mut s.scratch());
        x
    };
    let (a, b) = (solve(ours), solve(full));
    ensure!(a.len() == b.len(), "{} and {} unknowns", a.len(), b.len());
    let largest = |v: &mut dyn Iterator<Item = f64>| v.fold(0.0, |m: f64, v| m.max(v.abs()));
    let off = largest(&mut a.iter().zip(&b).map(|(a, b)| a - b));
    let scale = largest(&mut b.iter().copied());
    ensure!(
        off <= 1e-6 * scale,
        "appended and full factor differ by {:e} of the displacement",
        off / scale
    );
    Ok(())
}
