//! The paper's Table 1 in `metrics.json`, taken after a session on its own bone, hands and cracks: parts of steps cannot be timed
//! within the loops, since mechanics reads no clock.
use crate::engine::{Engine, Prepared};
use crate::loops::timed;
use crate::picture::{Restored, Stage, View};
use crate::session::{HandSample, Recording};
use anyhow::Result;
use osteotome_mechanics::contact::{BoundingVolumes, NearPoints, penetrations};
use osteotome_mechanics::crack::CrackedBody;
use osteotome_mechanics::tool::ToolModel;
use osteotome_render::{Options, Renderer};

/// Durations of each part \[us\].
#[derive(Clone, Debug, Default)]
pub struct StepTimes {
    /// Both tools' points found.
    pub collision_query: Vec<f64>,
    /// Cells' matrices and their volumes made anew.
    pub collision_update: Vec<f64>,
    /// Surfaces led to a state of the bone.
    pub visual_update: Vec<f64>,
    /// Stiffness of what a growth appends.
    pub linearisation: Vec<f64>,
    /// Factor of it.
    pub factorisation: Vec<f64>,
    /// A picture of 1280 x 720.
    pub csg_render: Vec<f64>,
}

/// Stretches of so many haptic steps, and how many of them.
const STRETCH: usize = 25;
const STRETCHES: usize = 20;
/// As the haptic loop's own scratch.
const ROOM: usize = 16_384;
/// Times that the bone is made to follow.
const UPDATES: usize = 40;
/// Moments that are looked at, and pictures drawn of them.
const LOOKS: usize = 12;
const PICTURES: usize = 3;
const SIZE: [usize; 2] = [1280, 720];

impl StepTimes {
    /// Contact, on the bone as it ended, at poses that the tools have had.
    pub fn contact(&mut self, engine: &Engine, tools: &ToolModel, hands: &[Vec<HandSample>; 2]) {
        let (bone, whole) = (engine.main.bone(), engine.main.whole_state());
        let scene = whole.scene(bone);
        let mut near = [0, 1].map(|_| NearPoints::with_capacity(ROOM));
        let mut found = [0, 1].map(|_| Vec::with_capacity(ROOM));
        let n = hands[0].len();
        let apart = (n / STRETCHES).max(STRETCH);
        for k in (0..n).filter(|k| k % apart < STRETCH) {
            let ((), us) = timed(|| {
                for t in 0..2 {
                    let (shape, pose) = (&tools.tools[t].shape, &hands[t][k].tool_pose);
                    near[t].follow(shape, pose, &scene);
                    penetrations(shape, pose, &near[t], &mut found[t]);
                }
            });
            // The first of a stretch comes from afar, as no step of a session does.
            if k % apart > 0 {
                self.collision_query.push(us);
            }
        }
        let mut state = engine.main.state().clone();
        let mut volumes = BoundingVolumes::default();
        for _ in 0..UPDATES {
            let ((), us) = timed(|| {
                bone.deform(&mut state);
                volumes.update(&bone.shell, &state.deformation);
            });
            self.collision_update.push(us);
        }
    }

    /// Each growth's equations once more.
    ///
    /// # Errors
    /// A recording that does not fit the bone.
    pub fn growths(&mut self, prepared: &Prepared, recording: &Recording) -> Result<()> {
        let mut restored = Restored::new(&prepared.bone.cracked);
        for k in 1..recording.growth.len() {
            let before = restored.body().clone();
            restored.go_to(k, &recording.growth)?;
            self.growth(&before, restored.body())?;
        }
        Ok(())
    }

    fn growth(&mut self, before: &CrackedBody, after: &CrackedBody) -> Result<()> {
        let solid = &before.solid;
        let (mesh, materials, supports) = (&solid.mesh, &solid.materials, &solid.supports);
        let (grown, both) = timed(|| {
            before
                .system
                .grown(mesh, materials, &after.topology, supports)
        });
        let rows = grown?.last_rows();
        let (factor, us) = timed(|| before.system.factor().grown(&rows));
        factor?;
        self.factorisation.push(us);
        self.linearisation.push((both - us).max(0.0));
        Ok(())
    }

    /// What is seen of it.
    ///
    /// # Errors
    /// A recording that does not fit the bone.
    pub fn views(&mut self, stage: &mut Stage, renderer: &mut Renderer) -> Result<()> {
        let end = stage.recording().bone.last().map_or(0.0, |b| b.time);
        let camera = stage.camera(View::Close, SIZE[0] as f64 / SIZE[1] as f64);
        for k in 0..=LOOKS {
            let (moment, us) = timed(|| stage.at(end * k as f64 / LOOKS as f64, 0.0));
            let moment = moment?;
            // The first makes what later ones find there.
            if k == 0 {
                continue;
            }
            self.visual_update.push(us);
            if k % (LOOKS / PICTURES) == 0 {
                let options = Options {
                    width: SIZE[0],
                    height: SIZE[1],
                    samples: 1,
                    is_transparent: false,
                };
                let (image, us) = timed(|| renderer.image(&moment.scene(), &camera, &options));
                std::hint::black_box(image);
                self.csg_render.push(us);
            }
        }
        Ok(())
    }
}
