//! The scene at any time of a session.
use super::anchored::{drawn_cells, piece_of};
use super::crack_skin::GapSkin;
use super::props::{Figure, Prop, load};
use super::skins::{Dressed, GrowthState, Skinner};
use super::{head, look, views::View};
use crate::engine::Prepared;
use crate::scenario::{Eyes, Scenario};
use crate::session::{BoneSample, HandSample, Recording};
use anyhow::{Result, bail};
use osteotome_mechanics::crack::CrackedBody;
use osteotome_mechanics::geometry::Vec3;
use osteotome_mechanics::tool::{Chisel, ChiselParameters};
use osteotome_render::Scene;
use osteotome_render::skin::{MovedCell, Skin as Drawn};
use std::sync::Arc;

/// A recorded session ready to be looked at.
pub struct Stage<'a> {
    scenery: Scenery<'a>,
    skinner: Skinner<'a>,
    recording: &'a Recording,
    shows_head: bool,
    shows_tools: bool,
    views: Option<usize>,
}

/// A patient's bone, ready to be shown in any state of any session.
///
/// Skins are made elsewhere, by a [`Skinner`]: what is done here from frame to frame does not depend on whether the crack grows.
pub struct Scenery<'a> {
    prepared: &'a Prepared,
    scenario: &'a Scenario,
    chisels: [Figure; 2],
    /// With the schematic head, and what the patient came with alone.
    around: [Arc<[Prop]>; 2],
    dressed: Arc<Dressed>,
    /// As last shown.
    cells: Arc<[MovedCell]>,
}

/// What is to be shown of a session.
#[derive(Clone, Copy)]
pub struct Instant<'a> {
    /// When \[s\].
    pub time: f64,
    /// The bone's state; `None`: sawn and at rest.
    pub bone: Option<&'a BoneSample>,
    /// Both hands.
    pub hands: [&'a HandSample; 2],
    /// How far fragments are taken apart, off all faces that held them, all but the largest \[mm\].
    pub apart: f64,
    /// Whether the chisels are shown, and their loads.
    pub shows_tools: bool,
    /// Whether arrows show the loads.
    pub shows_loads: bool,
    /// Whether a schematic head shows from where the chisels can come.
    pub shows_head: bool,
}

/// What is to be seen at one moment.
pub struct Moment {
    /// When \[s\].
    pub time: f64,
    /// Load of each hand on the bone: force \[N\] and torque \[N mm\].
    pub loads: [[f64; 2]; 2],
    /// What moves with the bone, and the cells that move it.
    skins: Arc<[Drawn]>,
    cells: Arc<[MovedCell]>,
    /// All else, and what stands still.
    props: Vec<Prop>,
    around: Arc<[Prop]>,
    /// The latest growth.
    pub growth: GrowthState,
    eyes: Eyes,
}

impl Moment {
    /// How two eyes look at it.
    pub fn eyes(&self) -> Eyes {
        self.eyes
    }

    /// For the renderer.
    pub fn scene(&self) -> Scene<'_> {
        Scene {
            skins: &self.skins,
            cells: &self.cells,
            meshes: self
                .props
                .iter()
                .chain(&*self.around)
                .map(Prop::mesh)
                .collect(),
            background: look::BACKGROUND,
        }
    }
}

impl<'a> Stage<'a> {
    /// From a recording and the bone built from its scenario.
    ///
    /// # Errors
    /// A recording without the bone's states, or of another bone.
    pub fn new(prepared: &'a Prepared, recording: &'a Recording) -> Result<Self> {
        if recording.bone.is_empty() {
            bail!("the bone's displacements are not recorded; record the session again");
        }
        let mut skinner = Skinner::new(prepared);
        let sawn = skinner.sawn()?;
        Ok(Self {
            scenery: Scenery::new(prepared, &recording.scenario.scenario, sawn)?,
            skinner,
            recording,
            shows_head: false,
            shows_tools: true,
            views: None,
        })
    }

    /// Shows a schematic head, or not.
    pub fn show_head(&mut self, is_shown: bool) {
        self.shows_head = is_shown;
    }

    /// Shows the chisels and their loads, or not.
    pub fn show_tools(&mut self, are_shown: bool) {
        self.shows_tools = are_shown;
    }

    /// Looks from so many places side by side where pictures are in stereo, whatever the scenario says.
    pub fn look_from(&mut self, views: Option<usize>) {
        self.views = views;
    }

    /// The recording.
    pub fn recording(&self) -> &Recording {
        self.recording
    }

    /// A view's camera.
    pub fn camera(&self, view: View, aspect: f64) -> osteotome_render::Camera {
        view.camera(self.scenery.prepared, aspect)
    }

    /// The scene at `time` \[s\], or at the session's nearest end: hands of that step, the bone as last recorded before. All
    /// fragments but the largest are moved `apart` \[mm\], off all faces that held them.
    ///
    /// # Errors
    /// A recording that does not fit the bone.
    pub fn at(&mut self, time: f64, apart: f64) -> Result<Moment> {
        let recording = self.recording;
        let bones = &recording.bone;
        let k = bones.partition_point(|b| b.time <= time + 1e-9);
        let step = (time / self.scenery.scenario.loops.dt()).round().max(0.0) as usize;
        let instant = Instant {
            time,
            bone: bones.get(k.saturating_sub(1)),
            hands: recording
                .hands
                .each_ref()
                .map(|h| &h[step.min(h.len() - 1)]),
            apart,
            shows_tools: self.shows_tools,
            shows_loads: true,
            shows_head: self.shows_head,
        };
        if !self.scenery.suits(instant.bone) {
            let generation = usize::try_from(generation(instant.bone))?;
            let dressed = self.skinner.make(generation, &recording.growth)?;
            self.scenery.dress(dressed, instant.bone)?;
        }
        let mut moment = self.scenery.moment(&instant)?;
        moment.eyes.views = self.views.or(moment.eyes.views);
        Ok(moment)
    }
}

impl<'a> Scenery<'a> {
    /// Of a session with this bone and this scenario.
    ///
    /// # Errors
    /// A chisel that mechanics refuses.
    pub fn new(prepared: &'a Prepared, scenario: &'a Scenario, sawn: Arc<Dressed>) -> Result<Self> {
        let blade = |i: usize| {
            let c = &scenario.tool[i].chisel;
            let chisel = Chisel::new(ChiselParameters {
                width: c.width,
                thickness: c.thickness,
                bevel_deg: c.bevel_deg,
                length: c.length,
            })?;
            anyhow::Ok(Figure::of(&chisel))
        };
        let own = head::surroundings(prepared);
        let all = own.iter().cloned().chain(head::schematic(prepared));
        Ok(Self {
            chisels: [blade(0)?, blade(1)?],
            around: [all.collect::<Vec<_>>().into(), own.into()],
            cells: cells_of(&sawn.body, None)?,
            dressed: sawn,
            prepared,
            scenario,
        })
    }

    /// Whether the skins are those of a state's generation; `None`: of the sawn bone.
    pub fn suits(&self, bone: Option<&BoneSample>) -> bool {
        self.dressed.generation as u64 == generation(bone)
    }

    /// The generation whose skins are shown.
    pub fn generation(&self) -> usize {
        self.dressed.generation
    }

    /// Goes over to another generation, in a state of that generation.
    ///
    /// # Errors
    /// A state that does not fit.
    pub fn dress(&mut self, dressed: Arc<Dressed>, bone: Option<&BoneSample>) -> Result<()> {
        self.cells = cells_of(&dressed.body, bone)?;
        self.dressed = dressed;
        Ok(())
    }

    /// The scene at an instant. A bone whose generation the skins do not suit stays as it was last shown.
    ///
    /// # Errors
    /// A state that does not fit the bone.
    pub fn moment(&mut self, now: &Instant) -> Result<Moment> {
        if self.suits(now.bone) {
            self.cells = cells_of(&self.dressed.body, now.bone)?;
        }
        let cells = match now.apart > 0.0 {
            true => taken_apart(&self.dressed, &self.cells, now.apart),
            false => self.cells.clone(),
        };
        let mut props = Vec::new();
        let mut loads = [[0.0; 2]; 2];
        for (i, hand) in now.hands.iter().enumerate() {
            let (force, torque) = load_on_bone(hand, self.scenario, i);
            loads[i] = [force.norm(), torque.norm()];
            if now.shows_tools {
                props.extend(self.chisels[i].at(&hand.tool_pose));
            }
            if now.shows_tools && now.shows_loads {
                props.extend(load(look::LOADS[i], &hand.tool_pose, &force, &torque));
            }
        }
        Ok(Moment {
            time: now.time,
            loads,
            skins: self.dressed.drawn.clone(),
            cells,
            props,
            around: self.around[usize::from(!now.shows_head)].clone(),
            growth: self.dressed.growth,
            eyes: self.scenario.view,
        })
    }
}

/// Of a state; `None`: of the sawn bone.
fn generation(bone: Option<&BoneSample>) -> u64 {
    bone.map_or(0, |b| b.generation)
}

/// The cells' moved nodes; `None`: at rest.
fn cells_of(body: &CrackedBody, bone: Option<&BoneSample>) -> Result<Arc<[MovedCell]>> {
    let x = match bone {
        Some(bone) => unknowns(body, bone)?,
        None => vec![0.0; body.system.n()],
    };
    Ok(drawn_cells(body, &x))
}

fn unknowns(body: &CrackedBody, bone: &BoneSample) -> Result<Vec<f64>> {
    if bone.x_um.len() != body.system.n() {
        bail!(
            "the bone at {:.2} s has {} unknowns, {} are recorded",
            bone.time,
            body.system.n(),
            bone.x_um.len()
        );
    }
    Ok(bone.x_um.iter().map(|v| f64::from(*v) * 1e-3).collect())
}

/// All fragments but the largest moved away from what they broke off.
fn taken_apart(dressed: &Dressed, cells: &[MovedCell], apart: f64) -> Arc<[MovedCell]> {
    let body = &dressed.body;
    let ways = away(body, &dressed.skins.gap);
    let way = |c: u32| ways[piece_of(body, c) as usize] * apart;
    let moved = |(c, nodes): (u32, &MovedCell)| {
        let way: [f32; 3] = way(c).cast::<f32>().into();
        nodes.map(|p| [0, 1, 2].map(|k| p[k] + way[k]))
    };
    (0u32..).zip(cells).map(moved).collect()
}

/// For each fragment a unit vector away from what it broke off; zero for the largest.
pub fn away(body: &CrackedBody, gap: &GapSkin) -> Vec<Vec3> {
    let fragment = |c: usize| piece_of(body, c as u32) as usize;
    let mut faces = vec![Vec::new(); body.fragments.volume_share.len()];
    for ([a, b], area) in &gap.pieces {
        let [a, b] = [*a, *b].map(|c| fragment(c as usize));
        if a != b {
            faces[b].push(*area);
            faces[a].push(-area);
        }
    }
    faces[0].clear();
    faces.iter().map(|f| parting_way(f)).collect()
}

/// A direction that leads off all faces with these area vectors, which look along it, as steeply as may be.
///
/// Along their mean, a fragment slides in the plane of a face that is square to most others: a saw's slit would be sheared instead of
/// opened. So what opens little counts more, round by round; few and small faces that look elsewhere still count for little.
fn parting_way(faces: &[Vec3]) -> Vec3 {
    /// A face that opens by nothing counts e^SHARP times as much as one that opens squarely.
    const SHARP: f64 = 5.0;
    const ROUNDS: usize = 60;
    let unit = |v: Vec3| v.try_normalize(1e-9);
    let Some(mut way) = unit(faces.iter().sum()) else {
        return Vec3::zeros();
    };
    for _ in 0..ROUNDS {
        let opens = |f: &Vec3| (f.dot(&way) / f.norm().max(1e-12)).max(0.0);
        let counted = |f: &Vec3| f * (-SHARP * opens(f)).exp();
        let Some(better) = unit(faces.iter().map(counted).sum()) else {
            break;
        };
        way = unit(way * 0.8 + better * 0.2).unwrap_or(way);
    }
    way
}

/// What a hand does to the bone: the opposite of what its device displays, unscaled.
pub fn load_on_bone(hand: &HandSample, scenario: &Scenario, i: usize) -> (Vec3, Vec3) {
    let tool = &scenario.tool[i];
    let unscaled = |v: Vec3, scale: f64| {
        if scale > 0.0 {
            -v / scale
        } else {
            Vec3::zeros()
        }
    };
    (
        unscaled(hand.wrench.force, tool.force_scale),
        unscaled(hand.wrench.torque, tool.torque_scale),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fragments_come_off_all_faces_that_hold_them() {
        // As a sagittal split: most of it broken sideways, a saw's cut each from above and from before, and a stray chip.
        let faces = [
            Vec3::new(700.0, 0.0, 0.0),
            Vec3::new(0.0, 0.0, 150.0),
            Vec3::new(0.0, 120.0, 0.0),
            Vec3::new(-3.0, 0.0, -4.0),
        ];
        let way = parting_way(&faces);
        assert!((way.norm() - 1.0).abs() < 1e-12);
        for face in &faces[..3] {
            let opens = face.normalize().dot(&way);
            assert!(opens > 0.3, "{face:?} opens by {opens}");
        }
        // A flat face is left squarely, what has none stays.
        let flat = parting_way(&[Vec3::new(0.0, 2.0, 0.0); 3]);
        assert!((flat - Vec3::y()).norm() < 1e-12);
        assert_eq!(parting_way(&[]), Vec3::zeros());
    }
}
