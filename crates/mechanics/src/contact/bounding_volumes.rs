use super::PointShell;
use crate::geometry::{LANES, Vec3};
use nalgebra::Matrix3x4;
use wide::f32x4;

/// A ball around each cell that holds points (paper 4.2 has boxes in a spatial hash).
///
/// A point inside a cell is a convex combination of the cell's deformed virtual nodes, so the ball about their mean that
/// holds them holds it, and the points themselves are not touched. Balls are what a query asks for, four at a time, and a larger ball about
/// each sixteen neighbours lets most be passed over; nothing is sorted or hashed, so that a new state costs one pass over the nodes.
/// Double-buffer by owning two. [`update`](Self::update) allocates only while it grows past its largest size so far; queries never do.
#[derive(Debug, Default)]
pub struct BoundingVolumes {
    /// Of the cells that hold points, in the order of [`PointShell::occupied`].
    balls: Vec<Balls>,
    /// About each sixteen of these.
    groups: Vec<Balls>,
    middle: Vec3,
}

/// Copies into the memory that is there: a main step hands a copy on, and memory given back to the system would be taken from under
/// all threads.
impl Clone for BoundingVolumes {
    fn clone(&self) -> Self {
        let mut copy = Self::default();
        copy.clone_from(self);
        copy
    }

    fn clone_from(&mut self, other: &Self) {
        self.balls.clone_from(&other.balls);
        self.groups.clone_from(&other.groups);
        self.middle = other.middle;
    }
}

/// Nodes are used up to this far from the origin \[mm\]; beyond lies only a deformation that has blown up.
const REACH: f32 = 1e5;

impl BoundingVolumes {
    /// Volumes of a shell in a first state.
    pub fn new(shell: &PointShell, deformation: &[Matrix3x4<f32>]) -> Self {
        let mut volumes = Self::default();
        volumes.update(shell, deformation);
        volumes
    }

    /// Follows the bone to a new state. A cell whose nodes are not finite or farther than 100 m is nowhere.
    pub fn update(&mut self, shell: &PointShell, deformation: &[Matrix3x4<f32>]) {
        let fours = shell.occupied().chunks(LANES);
        self.balls.clear();
        (self.balls).extend(fours.map(|cells| Balls::of_cells(shell, deformation, cells)));
        self.group();
        self.middle = middle(&self.balls);
    }

    /// Follows the bone where only some cells have moved, ascending; the others keep their volumes.
    pub fn update_cells(
        &mut self,
        shell: &PointShell,
        deformation: &[Matrix3x4<f32>],
        cells: &[u32],
    ) {
        let occupied = shell.occupied();
        if self.balls.len() != occupied.len().div_ceil(LANES) {
            return self.update(shell, deformation);
        }
        let (mut place, mut renewed) = (0, 0);
        for c in cells {
            place += occupied[place..].partition_point(|o| o < c);
            let four = place / LANES;
            if occupied.get(place) != Some(c) || four < renewed {
                continue;
            }
            let own = &occupied[four * LANES..occupied.len().min((four + 1) * LANES)];
            self.balls[four] = Balls::of_cells(shell, deformation, own);
            renewed = four + 1;
        }
        self.group();
    }

    fn group(&mut self) {
        let fours_of_groups = self.balls.chunks(LANES * LANES);
        self.groups.clear();
        (self.groups).extend(fours_of_groups.map(|balls| Balls::about(balls.chunks(LANES))));
    }

    /// The balls, four at a time, in the order of [`PointShell::occupied`].
    pub(super) fn balls(&self) -> &[Balls] {
        &self.balls
    }

    /// Balls about each sixteen of these, four at a time.
    pub(super) fn groups(&self) -> &[Balls] {
        &self.groups
    }

    /// A place amid the volumes: of what lies about it differences are exact enough in single precision.
    pub fn middle(&self) -> &Vec3 {
        &self.middle
    }

    /// Centre and radius \[mm\] of the volume of the cell at a place of [`PointShell::occupied`]; NaN if it is nowhere.
    pub fn ball(&self, place: usize) -> Option<([f32; 3], f32)> {
        let [x, y, z, radius] = &self.balls.get(place / LANES)?.numbers;
        let l = place % LANES;
        Some(([x[l], y[l], z[l]], radius[l]))
    }
}

/// Four balls. Those that are nowhere, or fill up, are NaN.
#[derive(Clone, Copy, Debug)]
pub(super) struct Balls {
    /// Centres \[mm\], then radii.
    pub numbers: [[f32; LANES]; 4],
}

impl Balls {
    fn new([x, y, z]: [f32x4; 3], radius: f32x4) -> Self {
        let reach = f32x4::splat(REACH);
        // Written so that NaN fails.
        let is_near = |v: f32x4| v.abs().simd_lt(reach);
        let is_known = is_near(x) & is_near(y) & is_near(z) & is_near(radius);
        let known = |v: f32x4| is_known.select(v, f32x4::splat(f32::NAN)).to_array();
        Self {
            numbers: [known(x), known(y), known(z), known(radius)],
        }
    }

    /// About up to four cells. Points that reach out of a cell by an overhang lie in its copy enlarged about the mean of its nodes.
    fn of_cells(shell: &PointShell, deformation: &[Matrix3x4<f32>], cells: &[u32]) -> Self {
        let nowhere = f32x4::splat(f32::NAN);
        let mut rows = [[nowhere; LANES]; 3];
        let mut scale = [1.0; LANES];
        for (l, c) in cells.iter().enumerate().take(LANES) {
            let Some(d) = deformation.get(*c as usize) else {
                continue;
            };
            if let [a, b, c, d, e, f, g, h, i, j, k, m] = *d.as_slice() {
                rows[0][l] = f32x4::new([a, b, c, d]);
                rows[1][l] = f32x4::new([e, f, g, h]);
                rows[2][l] = f32x4::new([i, j, k, m]);
            }
            scale[l] = 1.0 + 4.0 * shell.overhang(*c as usize);
        }
        let [first, second, third] = rows.map(f32x4::transpose);
        let nodes = [
            [first[0], first[1], first[2]],
            [first[3], second[0], second[1]],
            [second[2], second[3], third[0]],
            [third[1], third[2], third[3]],
        ];
        let quarter = f32x4::splat(0.25);
        let centre = [0, 1, 2]
            .map(|k| ((nodes[0][k] + nodes[1][k]) + (nodes[2][k] + nodes[3][k])) * quarter);
        let farthest = nodes.map(|n| distance2(&n, &centre));
        let [a, b, c, d] = farthest;
        let radius = larger(larger(a, b), larger(c, d)).sqrt() * f32x4::new(scale);
        Self::new(centre, radius)
    }

    /// A ball about the balls of each of up to four fours of fours; those that are nowhere do not count.
    fn about<'a>(fours: impl Iterator<Item = &'a [Self]>) -> Self {
        let mut numbers = [[f32::NAN; LANES]; 4];
        for (l, balls) in fours.enumerate().take(LANES) {
            let ball = enclosing(balls);
            for (to, v) in numbers.iter_mut().zip(ball) {
                to[l] = v;
            }
        }
        Self { numbers }
    }
}

/// Centre and radius of a ball about some; NaN if all are nowhere. Smaller ones could be found.
fn enclosing(balls: &[Balls]) -> [f32; 4] {
    let infinite = f32x4::splat(f32::INFINITY);
    let (mut low, mut high) = ([infinite; 3], [-infinite; 3]);
    for b in balls {
        let radius = f32x4::new(b.numbers[3]);
        for k in 0..3 {
            let c = f32x4::new(b.numbers[k]);
            low[k] = smaller(low[k], c - radius);
            high[k] = larger(high[k], c + radius);
        }
    }
    let least = low.map(|v| v.to_array().into_iter().fold(f32::INFINITY, f32::min));
    let most = high.map(|v| v.to_array().into_iter().fold(f32::NEG_INFINITY, f32::max));
    let centre = [0, 1, 2].map(|k| 0.5 * (least[k] + most[k]));
    let mut radius = f32x4::ZERO;
    for b in balls {
        let [x, y, z, own] = b.numbers.map(f32x4::new);
        let away = distance2(&[x, y, z], &centre.map(f32x4::splat)).sqrt() + own;
        radius = larger(radius, away);
    }
    let [x, y, z] = centre;
    [x, y, z, radius.to_array().into_iter().fold(0.0, f32::max)]
}

fn distance2(a: &[f32x4; 3], b: &[f32x4; 3]) -> f32x4 {
    let [x, y, z] = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    x * x + y * y + z * z
}

/// The larger of both, the first where the second is NaN.
fn larger(a: f32x4, b: f32x4) -> f32x4 {
    b.simd_gt(a).select(b, a)
}

/// The smaller of both, the first where the second is NaN.
fn smaller(a: f32x4, b: f32x4) -> f32x4 {
    b.simd_lt(a).select(b, a)
}

/// Mean of the centres.
fn middle(balls: &[Balls]) -> Vec3 {
    let mut sum = [f32x4::ZERO; 4];
    for b in balls {
        let centre = b.numbers.map(f32x4::new);
        let is_known = centre[0].simd_eq(centre[0]);
        for (sum, c) in sum
            .iter_mut()
            .zip([centre[0], centre[1], centre[2], f32x4::ONE])
        {
            *sum += is_known.select(c, f32x4::ZERO);
        }
    }
    let [x, y, z, n] = sum.map(|s| f64::from(s.reduce_add()));
    if n > 0.0 {
        Vec3::new(x, y, z) / n
    } else {
        Vec3::zeros()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contact::{ShellPoints, boundary_points};
    use crate::geometry::block_mesh;

    /// A block's shell, and its nodes moved without pattern.
    fn block() -> (PointShell, Vec<Matrix3x4<f32>>) {
        let mesh = block_mesh(Vec3::zeros(), Vec3::new(12.0, 8.0, 6.0), [6, 4, 3]);
        let points = boundary_points(&mesh, 3);
        let cells: Vec<u32> = points.iter().map(|p| p.tet).collect();
        let shell = PointShell::group(&ShellPoints::new(points.into()), &cells, mesh.tets().len());
        let noise = |i: usize| 0.3 * (12.9898 * i as f32).sin();
        let cell = |t: usize| {
            let nodes = mesh.corners(t).map(|x| x.map(|v| v as f32));
            Matrix3x4::from_columns(&nodes).map_with_location(|r, c, v| v + noise(t + 7 * r + c))
        };
        let deformation = (0..mesh.tets().len()).map(cell).collect();
        (shell, deformation)
    }

    fn bits(balls: &[Balls]) -> Vec<u32> {
        let numbers = balls.iter().flat_map(|b| b.numbers).flatten();
        numbers.map(f32::to_bits).collect()
    }

    #[test]
    fn volumes_hold_the_points_of_their_cells_and_groups_their_volumes() {
        let (shell, deformation) = block();
        let volumes = BoundingVolumes::new(&shell, &deformation);
        let distance =
            |a: &[f32; 3], b: &[f32; 3]| (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt();
        for (place, &cell) in shell.occupied().iter().enumerate() {
            let (centre, radius) = volumes.ball(place).unwrap();
            for k in shell.places(cell as usize..cell as usize + 1) {
                let weights = nalgebra::Vector4::from(shell.weights(k).unwrap());
                let p: [f32; 3] = (deformation[cell as usize] * weights).into();
                assert!(distance(&p, &centre) <= radius + 1e-4);
            }
            let (group, l) = (place / 64, place / 16 % 4);
            let [x, y, z, around] = volumes.groups()[group].numbers.map(|n| n[l]);
            assert!(distance(&[x, y, z], &centre) + radius <= around + 1e-4);
        }
        assert!(shell.occupied().len() > 100);
    }

    #[test]
    fn cells_that_moved_are_renewed_as_all_would_be() {
        let (shell, mut deformation) = block();
        let mut volumes = BoundingVolumes::new(&shell, &deformation);
        let moved: Vec<u32> = (0..deformation.len() as u32)
            .filter(|c| c % 5 == 2)
            .collect();
        for c in &moved {
            deformation[*c as usize].add_scalar_mut(0.7);
        }
        // A bone that has blown up is nowhere, and its neighbours stay where they are.
        let lost = *shell.occupied().iter().find(|c| *c % 5 == 2).unwrap();
        deformation[lost as usize][(1, 2)] = f32::NAN;
        volumes.update_cells(&shell, &deformation, &moved);
        let anew = BoundingVolumes::new(&shell, &deformation);
        assert_eq!(bits(volumes.balls()), bits(anew.balls()));
        assert_eq!(bits(volumes.groups()), bits(anew.groups()));
        let place = shell.occupied().binary_search(&lost).unwrap();
        assert!(anew.ball(place).unwrap().1.is_nan());
        let known = (0..shell.occupied().len()).filter(|p| !anew.ball(*p).unwrap().1.is_nan());
        assert_eq!(known.count(), shell.occupied().len() - 1);
        assert!(anew.middle().iter().all(|v| v.is_finite()));
    }
}
