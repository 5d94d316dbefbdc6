//! Cracked blocks under load for the fracture tests: unstructured-like meshes, sheets, tractions, one factor a crack.
use super::noise;
use nalgebra::Matrix3;
use osteotome_mechanics::bone::{Supports, TetMaterial, stiffness};
use osteotome_mechanics::crack::growth::{Drive, GrowthLengths, Surroundings, grow};
use osteotome_mechanics::crack::load_control::FrontDrives;
use osteotome_mechanics::crack::stress_intensity::{CellForce, Fields, Station, evaluate};
use osteotome_mechanics::crack::{
    CrackSurface, CutEdges, EvaluatedFront, FacePiece, Front, Sheet, System, Topology, face_pieces,
};
use osteotome_mechanics::geometry::{TetLocator, TetMesh, TriMesh, Vec3};
use std::f64::consts::PI;

/// Grid lines from -`far` to `far`, even with `step` up to `near` from zero, growing by `ratio` beyond.
pub fn graded(near: f64, far: f64, step: f64, ratio: f64) -> Vec<f64> {
    let mut lines: Vec<f64> = (0..=(near / step).round() as usize)
        .map(|k| k as f64 * step)
        .collect();
    let mut width = step;
    while lines[lines.len() - 1] < far - 1e-9 {
        width *= ratio;
        lines.push(lines[lines.len() - 1] + width);
    }
    // The last lines are squeezed or stretched a little so that they end at `far`.
    let (from, end) = (near, lines[lines.len() - 1]);
    for x in lines.iter_mut().filter(|x| **x > from + 1e-9) {
        *x = from + (*x - from) * (far - from) / (end - from);
    }
    let mirrored: Vec<f64> = lines[1..].iter().rev().map(|x| -x).collect();
    mirrored.into_iter().chain(lines).collect()
}

/// `n` even cells from `min` to `max`.
pub fn even(min: f64, max: f64, n: usize) -> Vec<f64> {
    (0..=n)
        .map(|k| min + (max - min) * k as f64 / n as f64)
        .collect()
}

/// A body-centred block on grid lines: a node in each brick and on each boundary face, four tetrahedra round each inner face.
///
/// Inner nodes are moved at random by up to `jitter` of the local spacing, so that nothing is aligned with a crack. The mean
/// edge of an even grid of step c is .91 c.
pub fn centred_block(lines: [&[f64]; 3], jitter: f64, seed: u64) -> TetMesh {
    let n = lines.map(|l| l.len() - 1);
    let corner = |i: usize, j: usize, k: usize| (i + (n[0] + 1) * (j + (n[1] + 1) * k)) as u32;
    let mut random = noise(seed);
    let mut nodes = Vec::new();
    let shift = |axis: usize, i: usize, random: &mut dyn FnMut() -> f64| {
        let inner = i > 0 && i < n[axis];
        let r = random();
        if !inner {
            return lines[axis][i];
        }
        let room = (lines[axis][i + 1] - lines[axis][i]).min(lines[axis][i] - lines[axis][i - 1]);
        lines[axis][i] + jitter * room * r
    };
    for k in 0..=n[2] {
        for j in 0..=n[1] {
            for i in 0..=n[0] {
                nodes.push(Vec3::new(
                    shift(0, i, &mut random),
                    shift(1, j, &mut random),
                    shift(2, k, &mut random),
                ));
            }
        }
    }
    let brick = |i: usize, j: usize, k: usize| i + n[0] * (j + n[1] * k);
    let first_centre = nodes.len();
    for k in 0..n[2] {
        for j in 0..n[1] {
            for i in 0..n[0] {
                let at = [i, j, k];
                nodes.push(Vec3::from_fn(|a, _| {
                    let [lo, hi] = [lines[a][at[a]], lines[a][at[a] + 1]];
                    0.5 * (lo + hi) + jitter * (hi - lo) * random()
                }));
            }
        }
    }
    let mut tets = Vec::new();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for a in 0..=n[axis] {
            for b in 0..n[u] {
                for c in 0..n[v] {
                    let at = |db: usize, dc: usize| {
                        let mut p = [0; 3];
                        (p[axis], p[u], p[v]) = (a, b + db, c + dc);
                        corner(p[0], p[1], p[2])
                    };
                    let ring = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
                    let centre = |layer: usize| {
                        let mut p = [0; 3];
                        (p[axis], p[u], p[v]) = (layer, b, c);
                        (first_centre + brick(p[0], p[1], p[2])) as u32
                    };
                    let mut middle = || {
                        let m: Vec3 = ring.iter().map(|&r| nodes[r as usize]).sum::<Vec3>() / 4.0;
                        nodes.push(m);
                        nodes.len() as u32 - 1
                    };
                    let (low, high) = if a == 0 {
                        (middle(), centre(0))
                    } else if a == n[axis] {
                        (centre(a - 1), middle())
                    } else {
                        (centre(a - 1), centre(a))
                    };
                    for e in 0..4 {
                        tets.push([low, ring[e], ring[(e + 1) % 4], high]);
                    }
                }
            }
        }
    }
    TetMesh::new(nodes, tets).unwrap()
}

/// Mean edge length of the tetrahedra that touch `region` (min, max): the element size h near a crack.
pub fn element_size(mesh: &TetMesh, region: [Vec3; 2]) -> f64 {
    let inside = |p: &Vec3| (0..3).all(|k| p[k] >= region[0][k] && p[k] <= region[1][k]);
    let lengths: Vec<f64> = mesh
        .edges()
        .iter()
        .map(|e| e.map(|n| mesh.nodes()[n as usize]))
        .filter(|e| inside(&e[0]) && inside(&e[1]))
        .map(|[a, b]| (a - b).norm())
        .collect();
    lengths.iter().sum::<f64>() / lengths.len() as f64
}

/// A flat disc or ellipse about `centre` spanned by `u` and `v` (half axes), as rings of triangles; its normal is u x v.
pub fn ellipse(centre: Vec3, u: Vec3, v: Vec3, n_border: u32) -> TriMesh {
    let mut mesh = TriMesh {
        vertices: vec![centre],
        triangles: vec![],
    };
    for k in 0..n_border {
        let w = 2.0 * PI * f64::from(k) / f64::from(n_border);
        mesh.vertices.push(centre + u * w.cos() + v * w.sin());
        mesh.triangles.push([0, 1 + k, 1 + (k + 1) % n_border]);
    }
    mesh
}

/// A strip of quads between two lines of points; its far line is `b`, its normal (b - a) x along.
pub fn strip(a: &[Vec3], b: &[Vec3]) -> TriMesh {
    let n = a.len() as u32;
    let mut mesh = TriMesh {
        vertices: a.iter().chain(b).copied().collect(),
        triangles: vec![],
    };
    for k in 0..n - 1 {
        mesh.triangles.push([k, n + k, n + k + 1]);
        mesh.triangles.push([k, n + k + 1, k + 1]);
    }
    mesh
}

/// An uncracked body.
pub struct Specimen {
    pub mesh: TetMesh,
    pub locator: TetLocator,
    pub materials: Vec<TetMaterial>,
    pub supports: Supports,
    pub h: f64,
}

impl Specimen {
    /// Isotropic, held by ground springs of 1e-8 E h alone; `h`: element size near the crack.
    pub fn new(
        mesh: TetMesh,
        young_modulus: f64,
        poisson_ratio: f64,
        toughness: f64,
        h: f64,
    ) -> Self {
        let material = TetMaterial::isotropic(young_modulus, poisson_ratio, toughness);
        Self {
            locator: TetLocator::new(&mesh),
            materials: vec![material; mesh.tets().len()],
            supports: Supports {
                ground_spring: 1e-8 * young_modulus * h,
                ..Default::default()
            },
            mesh,
            h,
        }
    }

    /// What growth needs to know.
    pub fn surroundings(&self) -> Surroundings<'_> {
        Surroundings {
            mesh: &self.mesh,
            locator: &self.locator,
            lengths: GrowthLengths::for_element_size(self.h),
        }
    }

    /// Cuts the body along some sheets and, by the lead, ahead of their fronts.
    pub fn cut(&self, sheets: Vec<TriMesh>) -> Cracked<'_> {
        let sheet = |mesh: TriMesh| Sheet {
            kerf: vec![0.0; mesh.vertices.len()],
            mesh,
            ..Default::default()
        };
        let mut crack = CrackSurface {
            sheets: sheets.into_iter().map(sheet).collect(),
        };
        let cuts = self.surroundings().first_cuts(&mut crack, 1);
        Cracked::new(self, crack, cuts)
    }

    /// The traction sigma n on each boundary triangle for which `on` holds (centroid, unit normal).
    pub fn tractions(
        &self,
        on: impl Fn(&Vec3, &Vec3) -> bool,
        traction: impl Fn(&Vec3, &Vec3) -> Vec3,
    ) -> Vec<(Vec3, Vec3)> {
        let face = |f: &[u32; 3]| {
            let [a, b, c] = f.map(|n| self.mesh.nodes()[n as usize]);
            let area_normal = (b - a).cross(&(c - a)) * 0.5;
            ((a + b + c) / 3.0, area_normal)
        };
        let faces = self.mesh.boundary_faces().iter().map(face);
        faces
            .map(|(p, a)| (p, a.norm(), a.normalize()))
            .filter(|(p, _, n)| on(p, n))
            .map(|(p, area, n)| (p, traction(&p, &n) * area))
            .collect()
    }

    /// Remote stress: sigma n on the whole boundary.
    pub fn remote(&self, stress: Matrix3<f64>) -> Vec<(Vec3, Vec3)> {
        self.tractions(|_, _| true, |_, n| stress * n)
    }
}

/// A cracked body with its factor.
pub struct Cracked<'a> {
    pub specimen: &'a Specimen,
    pub crack: CrackSurface,
    pub cuts: CutEdges,
    pub topology: Topology,
    pub system: System,
}

/// A load case and its solution.
pub struct Solved {
    pub loads: Vec<CellForce>,
    pub x: Vec<f64>,
    /// Work of the loads f . x: twice the elastic energy \[N mm\].
    pub work: f64,
}

impl<'a> Cracked<'a> {
    pub fn new(specimen: &'a Specimen, crack: CrackSurface, cuts: CutEdges) -> Self {
        let topology = Topology::new(&specimen.mesh, &cuts);
        let system = System::new(
            &specimen.mesh,
            &specimen.materials,
            &topology,
            &specimen.supports,
        )
        .unwrap();
        Self {
            specimen,
            crack,
            cuts,
            topology,
            system,
        }
    }

    /// Forces at points, each in the cell that holds its point.
    pub fn at_points(&self, forces: &[(Vec3, Vec3)]) -> Vec<CellForce> {
        let place = |(p, f): &(Vec3, Vec3)| {
            let (tet, weights) = self
                .specimen
                .locator
                .find_near(&self.specimen.mesh, p, 1e-6)
                .unwrap();
            CellForce {
                cell: self.topology.cell_at(tet, &weights),
                weights,
                force: *f,
            }
        };
        forces.iter().map(place).collect()
    }

    /// Force pairs along z, 1 N in all on each face, at `n` places round a ring of radius `b` about `centre`.
    pub fn ring(&self, centre: Vec3, b: f64, n: u32) -> Vec<CellForce> {
        let (mesh, locator) = (&self.specimen.mesh, &self.specimen.locator);
        let pair = |k: u32| {
            let (sin, cos) = (2.0 * PI * f64::from(k) / f64::from(n)).sin_cos();
            let p = centre + Vec3::new(b * cos, b * sin, 0.0);
            let (tet, weights) = locator.find(mesh, &p).unwrap();
            [Vec3::z(), -Vec3::z()].map(|up| CellForce {
                cell: self.topology.cell_towards(mesh, tet, &p, &up),
                weights,
                force: up / f64::from(n),
            })
        };
        (0..n).flat_map(pair).collect()
    }

    /// The crack's faces inside the body as mechanics knows them.
    pub fn faces(&self) -> Vec<FacePiece> {
        let mut pieces = Vec::new();
        let mesh = &self.specimen.mesh;
        for t in 0..mesh.tets().len() as u32 {
            face_pieces(mesh, &self.cuts, &self.topology, t, |f| pieces.push(f));
        }
        pieces
    }

    /// A_eff: the crack's area, weighted by how far it is free to open \[mm2\].
    pub fn effective_area(&self) -> f64 {
        self.faces()
            .iter()
            .map(|f| f.freedom * f.area_normal.norm())
            .sum()
    }

    /// A pressure on both faces of the crack.
    pub fn pressure(&self, pressure: f64) -> Vec<CellForce> {
        let mesh = &self.specimen.mesh;
        let mut loads = Vec::new();
        for f in self.faces() {
            let weights = mesh.barycentric(f.tet as usize, &f.centre);
            for side in [1.0, -1.0] {
                let area = f.area_normal * side;
                let cell = self.topology.cell_towards(mesh, f.tet, &f.centre, &area);
                loads.push(CellForce {
                    cell,
                    weights,
                    force: area * pressure,
                });
            }
        }
        loads
    }

    pub fn solve(&self, loads: Vec<CellForce>) -> Solved {
        let mut x = vec![0.0; self.system.n()];
        for l in &loads {
            let cell = &self.topology.cells()[l.cell as usize];
            self.system
                .add_force(&self.specimen.mesh, cell, &l.weights, &l.force, &mut x);
        }
        let f = x.clone();
        self.system.solve(&mut x, &mut self.system.scratch());
        let work = f.iter().zip(&x).map(|(a, b)| a * b).sum();
        Solved { loads, x, work }
    }

    pub fn fronts(&self) -> Vec<Front> {
        let around = self.specimen.surroundings();
        self.crack
            .fronts(around.mesh, around.locator, around.lengths.stick())
    }

    pub fn fields<'b>(&'b self, solved: &'b Solved) -> Fields<'b> {
        let s = self.specimen;
        Fields {
            mesh: &s.mesh,
            locator: &s.locator,
            materials: &s.materials,
            cuts: &self.cuts,
            topology: &self.topology,
            system: &self.system,
            x: &solved.x,
            loads: &solved.loads,
        }
    }

    pub fn stations(&self, solved: &Solved, front: &Front) -> Vec<Station> {
        let fronts = std::slice::from_ref(front);
        evaluate(
            &self.fields(solved),
            &self.crack,
            fronts,
            self.specimen.h,
            0.0,
        )
        .remove(0)
    }

    /// The body after further cuts.
    pub fn then(&self, crack: CrackSurface, cuts: CutEdges, newly_cut: &[u32]) -> Cracked<'a> {
        let s = self.specimen;
        let topology = self.topology.grown(&s.mesh, &cuts, newly_cut);
        let system = (self.system)
            .grown(&s.mesh, &s.materials, &topology, &s.supports)
            .unwrap();
        Cracked {
            specimen: s,
            crack,
            cuts,
            topology,
            system,
        }
    }

    /// The crack grown by one increment, and the drives and stations of each front; `None` if it rests.
    pub fn grown(
        &self,
        solved: &Solved,
        lengths: GrowthLengths,
    ) -> Option<(Cracked<'a>, Vec<GrownFront>)> {
        let around = Surroundings {
            lengths,
            ..self.specimen.surroundings()
        };
        let (mut crack, mut cuts) = (self.crack.clone(), self.cuts.clone());
        let (mut grown, mut newly_cut) = (Vec::new(), Vec::new());
        let fronts = self.fronts();
        let all = evaluate(
            &self.fields(solved),
            &self.crack,
            &fronts,
            self.specimen.h,
            0.0,
        );
        for (front, stations) in fronts.iter().zip(all) {
            let alone = [EvaluatedFront {
                front: front.clone(),
                stations,
            }];
            let mut drives = FrontDrives::new(&alone, &lengths);
            let moves = drives.moves(&alone, &lengths, 1.0).remove(0);
            let drives = drives.smooth.remove(0);
            let [EvaluatedFront { stations, .. }] = alone;
            if moves.iter().any(|m| *m != Vec3::zeros()) {
                let strip = grow(&mut crack, front, &moves, &around);
                let (mesh, locator) = (&self.specimen.mesh, &self.specimen.locator);
                newly_cut.extend(strip.cut(&mut cuts, mesh, locator, 1));
                grown.push(GrownFront {
                    stations,
                    drives,
                    moves,
                });
            }
        }
        (!grown.is_empty()).then(|| (self.then(crack, cuts, &newly_cut), grown))
    }

    /// Cauchy stress in each cell.
    pub fn stresses(&self, x: &[f64]) -> Vec<Matrix3<f64>> {
        let mesh = &self.specimen.mesh;
        let stress = |cell: &osteotome_mechanics::crack::Cell| {
            let u = self.system.cell_displacements(mesh, cell, x);
            let t = cell.tet as usize;
            let grad_u = stiffness::displacement_gradient(&mesh.gradients()[t], &u);
            self.specimen.materials[t].elasticity().stress(&grad_u)
        };
        self.topology.cells().iter().map(stress).collect()
    }
}

/// What drove one front of a growth step, and how it moved.
pub struct GrownFront {
    pub stations: Vec<Station>,
    pub drives: Vec<Drive>,
    pub moves: Vec<Vec3>,
}

/// Mean and standard deviation.
pub fn mean_sd(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let var = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, var.sqrt())
}

/// Shows a measured figure (`cargo test -- --nocapture`).
#[allow(clippy::print_stderr)]
pub fn measured(figure: &str) {
    eprintln!("{figure}");
}

/// Whether the longer studies are asked for.
pub fn long() -> bool {
    std::env::var_os("OSTEOTOME_LONG").is_some()
}
