//! A mandible's split under force pairs instead of chisels: what the crack does by itself, without hands and contact.
//!
//! Two pairs of forces push the crack's faces apart where the built-in surgeon's chisels go in. They are as large as the crack's next
//! step needs, no larger: the load rises until the crack grows, and is lowered again after each growth. `kept`, the pairs stay at
//! the bottom of the saw's slit; where a plate has come off they go to the nearest place along the ridge that still has both walls, or as
//! high in the crack as there is a hold. `driven`, they follow the crack's front as far as a chisel reaches.
mod pairs;

use anyhow::{Context, Result, bail, ensure};
use osteotome::engine::{Prepared, final_bone, prepare};
use osteotome::scenario::{Override, Scenario, Source, load};
use osteotome::session::write_final_bone;
use osteotome::surgeon::SplitLine;
use osteotome_anatomy::Canal;
use osteotome_anatomy::stl::read_stl;
use osteotome_mechanics::bone::Supports;
use osteotome_mechanics::crack::Solid;
use osteotome_mechanics::crack::stress_intensity::CellForce;
use osteotome_mechanics::geometry::{MeshDistance, TetLocator, Vec3};
use osteotome_mechanics::step::{
    Body, Bone, BoneState, FaceContact, FacePlace, PropagationSettings, propagation_step,
};
use pairs::Holds;
use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;

/// The load after a growth, as a share of what it took; and by how much it rises while nothing grows.
const LOWERED: f64 = 0.8;
const RAISED: f64 = 1.1;
/// A pair's force at most \[N\].
const MOST_FORCE: f64 = 10_000.0;
/// Growth steps at most.
const MOST_STEPS: usize = 600;
/// What has broken is written whenever so many growths are done: on fine meshes the rest takes long.
const WRITTEN_EACH: usize = 25;

const USAGE: &str = "give jaw-split SCENARIO kept|driven OUT [plan=SURFACE.stl] [against=OTHER/faces.csv] [KEY=VALUE...]";

/// Where the pairs of forces act.
#[derive(Clone, Copy, PartialEq)]
enum Strategy {
    Kept,
    Driven,
}

/// One growth.
struct Step {
    /// Of each pair \[N\].
    force: f64,
    /// Of the crack after it \[mm2\].
    area: f64,
    /// Pairs of faces that press on each other before it.
    closed: usize,
}

/// Runs the chore with what follows its name.
pub fn run(arguments: &[String]) -> Result<()> {
    let [scenario, strategy, out, rest @ ..] = arguments else {
        bail!(USAGE);
    };
    let strategy = match strategy.as_str() {
        "kept" => Strategy::Kept,
        "driven" => Strategy::Driven,
        other => bail!("{other}: there is no such strategy; {USAGE}"),
    };
    let named = |name: &str| rest.iter().find_map(|a| a.strip_prefix(name));
    let settings = rest.iter();
    let settings = settings.filter(|a| !a.starts_with("plan=") && !a.starts_with("against="));
    let settings: Vec<Override> = settings.map(|s| s.parse()).collect::<Result<_>>()?;
    let here = std::env::current_dir()?;
    let scenario = load(&Source::File(scenario.into()), &settings, &here)?;
    let out = Path::new(out);
    std::fs::create_dir_all(out)?;
    let mut study = Study::new(&scenario, prepare(&scenario, &mut |_, _| ())?, strategy)?;
    study.split(out)?;
    study.write(out)?;
    study.print();
    let faces = study.broken();
    if let Some(plan) = named("plan=") {
        let plan = MeshDistance::new(read_stl(Path::new(plan))?);
        let far: Vec<f64> = faces.iter().map(|f| plan.unsigned(&f.position)).collect();
        println!("off the planned surface: {}", summary(&faces, &far));
        std::fs::write(out.join("crack.svg"), picture(&faces, &far))?;
    }
    if let Some(other) = named("against=") {
        let other = read_faces(Path::new(other))?;
        let far: Vec<f64> = faces.iter().map(|f| nearest(&f.position, &other)).collect();
        println!("off the other crack: {}", summary(&faces, &far));
    }
    Ok(())
}

struct Study {
    bone: Bone,
    line: SplitLine,
    canals: Vec<Canal>,
    stations: [f64; 2],
    strategy: Strategy,
    steps: Vec<Step>,
}

impl Study {
    fn new(scenario: &Scenario, prepared: Prepared, strategy: Strategy) -> Result<Self> {
        let sawn = &prepared.bone;
        let body = &sawn.body;
        let solid = Solid {
            locator: TetLocator::new(&body.mesh),
            mesh: body.mesh.clone(),
            materials: body.materials.clone(),
            lengths: body.lengths,
            // What rests does not feel the drag of soft tissue.
            supports: Supports {
                drag: 0.0,
                ..body.supports.clone()
            },
        };
        let body = Body {
            solid: Arc::new(solid),
            ends: body.ends.clone(),
            region: body.region.clone(),
            surface: Vec::new(),
            wall_density: body.wall_density,
        };
        Ok(Self {
            bone: Bone::new(Arc::new(body), sawn.cracked.crack.clone())?,
            line: prepared.line,
            canals: prepared.patient.canals,
            stations: scenario.surgeon.stations,
            strategy,
            steps: Vec::new(),
        })
    }

    /// Grows the crack until the jaw is apart, nothing more grows or there is no place left to push.
    fn split(&mut self, out: &Path) -> Result<()> {
        let mut force: f64 = 50.0;
        while !self.bone.is_severed() && self.steps.len() < MOST_STEPS {
            let Some(unit) = self.pairs() else {
                eprintln!("there is no place left for the forces");
                break;
            };
            let Some((grown, step)) = self.grow(&unit, LOWERED * force)? else {
                eprintln!("nothing grows at {MOST_FORCE} N");
                break;
            };
            self.bone = grown;
            if self.bone.is_border_heavy() {
                let base = self.bone.refactored()?;
                self.bone.rebase(&base)?;
            }
            force = step.force;
            eprintln!(
                "{} {:.0} N {:.0} mm2, {} faces pressed, {} pieces",
                self.steps.len() + 1,
                step.force,
                step.area,
                step.closed,
                self.bone.fragments.count()
            );
            self.steps.push(step);
            if self.steps.len().is_multiple_of(WRITTEN_EACH) {
                self.write(out)?;
            }
        }
        Ok(())
    }

    /// The first growth as the load rises from `force`.
    fn grow(&self, unit: &[CellForce], mut force: f64) -> Result<Option<(Bone, Step)>> {
        let settings = PropagationSettings::default();
        while force <= MOST_FORCE {
            let state = self.under(unit, force);
            let (grown, report) = propagation_step(&self.bone, &state, &settings, None)?;
            if let Some(bone) = grown {
                let step = Step {
                    force,
                    area: bone.crack_area(),
                    closed: (state.loads.len() - unit.len()) / 2,
                };
                return Ok(Some((bone, step)));
            }
            // G goes by the square of the load.
            let to_start = (0.98 / report.strongest.sqrt()).min(2.0);
            force *= to_start.max(RAISED);
        }
        Ok(None)
    }

    /// The bone at rest under forces so many times `unit`.
    fn under(&self, unit: &[CellForce], times: f64) -> BoneState {
        let scaled = unit.iter().map(|l| CellForce {
            force: l.force * times,
            ..*l
        });
        let loads: Vec<_> = scaled.collect();
        self.bone.under_loads(&loads, &mut FaceContact::default())
    }

    /// Forces of 1 N to either side at each of the two places.
    fn pairs(&self) -> Option<Vec<CellForce>> {
        let holds = Holds::new(&self.bone, &self.line);
        let forces = match self.strategy {
            Strategy::Kept => holds.kept(self.stations),
            Strategy::Driven => holds.driven(self.stations),
        };
        (!forces.is_empty()).then_some(forces)
    }

    /// Where the bone broke.
    fn broken(&self) -> Vec<FacePlace> {
        let places = self.bone.faces.places(&self.bone);
        places.filter(|p| p.gap == 0.0).collect()
    }

    /// Which share of each canal lies on the same fragment as the jaw's other half.
    fn canal_kept(&self) -> Vec<f64> {
        let (body, pieces) = (&self.bone.body, &self.bone.fragments.of_node);
        let shares = self.bone.fragments.volume_share.iter().enumerate();
        let largest = shares
            .max_by(|a, b| a.1.total_cmp(b.1))
            .map(|(k, _)| k as u32);
        let stays = |p: &Vec3| {
            let nearest = body.embed(p).map(|(tet, w)| {
                let most = (0..4).max_by(|a, b| w[*a].total_cmp(&w[*b])).unwrap_or(0);
                pieces[body.mesh.tets()[tet as usize][most] as usize]
            });
            nearest == largest
        };
        let share =
            |c: &Canal| c.line.iter().filter(|p| stays(p)).count() as f64 / c.line.len() as f64;
        self.canals.iter().map(share).collect()
    }

    fn write(&self, out: &Path) -> Result<()> {
        let mut text = String::from("growth,force_n,area_mm2,pressed\n");
        for (k, s) in self.steps.iter().enumerate() {
            let _ = writeln!(text, "{k},{:.1},{:.2},{}", s.force, s.area, s.closed);
        }
        std::fs::write(out.join("steps.csv"), text)?;
        let mut text = String::from("x,y,z,area_mm2\n");
        for p in self.broken() {
            let x = p.position;
            let _ = writeln!(text, "{:.3},{:.3},{:.3},{:.4}", x.x, x.y, x.z, p.area);
        }
        std::fs::write(out.join("faces.csv"), text)?;
        let last = self.steps.last().map_or(0.0, |s| s.force);
        let state = self.under(&self.pairs().unwrap_or_default(), last);
        let bone = final_bone(&self.bone, &state);
        std::fs::write(out.join("bone.vtu"), write_final_bone(&bone))?;
        Ok(())
    }

    fn print(&self) {
        let mut forces: Vec<f64> = self.steps.iter().map(|s| s.force).collect();
        let start = forces.first().copied().unwrap_or(0.0);
        forces.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let last = forces.len().saturating_sub(1) as f64;
            forces
                .get((share * last).round() as usize)
                .copied()
                .unwrap_or(0.0)
        };
        println!(
            "severed: {}; {} pieces, {} growths, {:.0} mm2 with the saw's; {start:.0} N a pair to start, then {:.0} to {:.0} (middle half)",
            self.bone.is_severed(),
            self.bone.fragments.count(),
            self.steps.len(),
            self.bone.crack_area(),
            at(0.25),
            at(0.75)
        );
        for share in self.canal_kept() {
            println!(
                "canal: {:.0} % of it stays on the larger fragment",
                100.0 * share
            );
        }
    }
}

/// Mean by area and largest of distances \[mm\].
fn summary(faces: &[FacePlace], far: &[f64]) -> String {
    let area: f64 = faces.iter().map(|f| f.area).sum();
    let weighed = faces.iter().zip(far).map(|(f, d)| f.area * d);
    let near = faces.iter().zip(far).filter(|(_, d)| **d <= 2.0);
    format!(
        "{:.2} mm on average, {:.1} mm at most, {:.0} % of the broken face within 2 mm",
        weighed.sum::<f64>() / area,
        far.iter().copied().fold(0.0, f64::max),
        100.0 * near.map(|(f, _)| f.area).sum::<f64>() / area
    )
}

fn nearest(p: &Vec3, others: &[Vec3]) -> f64 {
    let far = others.iter().map(|o| (o - p).norm());
    far.fold(f64::INFINITY, f64::min)
}

/// The places of a `faces.csv`.
fn read_faces(path: &Path) -> Result<Vec<Vec3>> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    let place = |line: &str| {
        let mut numbers = line.split(',').map(str::parse::<f64>);
        let mut next = || numbers.next().and_then(Result::ok);
        Some(Vec3::new(next()?, next()?, next()?))
    };
    let places: Vec<Vec3> = text.lines().filter_map(place).collect();
    ensure!(!places.is_empty(), "{}: no places in it", path.display());
    Ok(places)
}

/// The broken face from the side (y, z) and from above (y, x), coloured by distance.
fn picture(faces: &[FacePlace], far: &[f64]) -> String {
    const CLASSES: [(f64, &str, &str); 4] = [
        (1.0, "#3b6fb6", "below 1 mm"),
        (2.0, "#5fae72", "1 to 2 mm"),
        (4.0, "#e3a23b", "2 to 4 mm"),
        (f64::INFINITY, "#b8383d", "more"),
    ];
    const SCALE: f64 = 6.0;
    let most = |of: fn(&Vec3) -> f64| {
        let all = faces.iter().map(|f| of(&f.position));
        all.fold(f64::NEG_INFINITY, f64::max)
    };
    let (y, z, x) = (most(|p| -p.y), most(|p| p.z), most(|p| p.x));
    let mut dots: [String; 4] = Default::default();
    for (f, d) in faces.iter().zip(far) {
        let class = CLASSES.iter().position(|c| *d < c.0).unwrap_or(3);
        let p = f.position;
        let across = SCALE * (y + p.y) + 20.0;
        for down in [z - p.z + 5.0, x - p.x + 75.0] {
            let _ = write!(dots[class], "M{across:.0} {:.0}h0", SCALE * down);
        }
    }
    let mut svg = String::from(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 420 560\" font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"420\" height=\"560\" fill=\"white\"/>\n<text x=\"20\" y=\"18\">from the side</text><text x=\"20\" y=\"440\">from above</text>\n",
    );
    for (k, ((_, colour, name), dots)) in CLASSES.iter().zip(dots).enumerate() {
        let _ = writeln!(
            svg,
            "<path d=\"{dots}\" stroke=\"{colour}\" stroke-width=\"6\" stroke-linecap=\"round\"/><text x=\"320\" y=\"{}\" fill=\"{colour}\">{name}</text>",
            470 + 18 * k
        );
    }
    svg + "</svg>\n"
}
