//! Draws the scene on threads of its own at a low priority: what comes late is dropped, and nobody waits for it.
use super::conductor::Ready;
use super::dresser::{Dresser, Wanted};
use super::live::{SharedLive, look};
use crate::picture::{Instant as Shown, Moment, Scenery, Skinner, StereoMode};
use crate::session::HandSample;
use anyhow::Result;
use eframe::egui::{Color32, ColorImage};
use osteotome_devices::Wrench;
use osteotome_mechanics::geometry::Pose;
use osteotome_render::{Camera, Image, Options, Renderer};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};
use thread_priority::{ThreadPriority, set_current_thread_priority};

/// How the scene is to be drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// From where.
    pub camera: Camera,
    /// Pixels of the window's part that shows it.
    pub size: [usize; 2],
    /// Whether one looks through the bone.
    pub is_transparent: bool,
    /// Whether arrows show the loads.
    pub shows_loads: bool,
    /// Whether a schematic head is shown.
    pub shows_head: bool,
    /// How far fragments are taken apart \[mm\].
    pub apart: f64,
    /// For two eyes.
    pub stereo: Option<StereoMode>,
}

/// A picture of the scene.
pub struct Seen {
    /// Pixels; fewer than asked for while the scene moves.
    pub image: ColorImage,
    /// From where.
    pub camera: Camera,
    /// How long it took \[ms\].
    pub ms: f64,
    /// What went wrong instead, if anything.
    pub fault: Option<String>,
}

#[derive(Default)]
struct Wish {
    look: Option<Look>,
    patient: Option<Arc<Ready>>,
    is_over: bool,
}

struct Shared {
    wish: Mutex<Wish>,
    changed: Condvar,
    seen: Mutex<Option<Seen>>,
    live: SharedLive,
    wake: Box<dyn Fn() + Send + Sync>,
}

/// The drawing thread's owner; dropping it ends the thread.
pub struct Eye {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Eye {
    /// Looks at `live`; `wake` is called whenever there is a new picture.
    ///
    /// # Errors
    /// If the system has no thread left.
    pub fn open(live: SharedLive, wake: impl Fn() + Send + Sync + 'static) -> Result<Self> {
        let shared = Arc::new(Shared {
            wish: Mutex::default(),
            changed: Condvar::new(),
            seen: Mutex::default(),
            live,
            wake: Box::new(wake),
        });
        let pool = pool()?;
        let of_thread = shared.clone();
        let thread = Builder::new()
            .name("eye".into())
            .spawn(move || watch(&of_thread, &pool))?;
        Ok(Self {
            shared,
            thread: Some(thread),
        })
    }

    /// Says what is to be seen from now on.
    pub fn wish(&self, look: Look, patient: &Arc<Ready>) {
        let mut wish = lock(&self.shared.wish);
        let is_same = wish
            .patient
            .as_ref()
            .is_some_and(|p| Arc::ptr_eq(p, patient));
        if !is_same {
            wish.patient = Some(patient.clone());
        }
        if wish.look != Some(look) || !is_same {
            wish.look = Some(look);
            self.shared.changed.notify_one();
        }
    }

    /// The newest picture, once.
    pub fn take(&self) -> Option<Seen> {
        lock(&self.shared.seen).take()
    }
}

impl Drop for Eye {
    fn drop(&mut self) {
        lock(&self.shared.wish).is_over = true;
        self.shared.changed.notify_one();
        // A drawing thread that has panicked has said so already.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Apart from the pool in which mechanics computes, and at a low priority: it takes what nobody else wants.
fn pool() -> Result<ThreadPool> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let pool = ThreadPoolBuilder::new()
        .num_threads(cores.min(8))
        .thread_name(|i| format!("eye {i}"))
        .start_handler(|_| yield_to_loops())
        .build()?;
    Ok(pool)
}

/// On a scale of 0 to 99, where threads have about 50 by themselves: a tenth of what a loop gets of a core that both want.
const PRIORITY: u8 = 25;

/// Best effort: where it is refused, the haptic loop still has raised its own priority.
fn yield_to_loops() {
    let low = PRIORITY.try_into().map(ThreadPriority::Crossplatform);
    let _ = set_current_thread_priority(low.unwrap_or(ThreadPriority::Min));
}

/// A picture of a moving scene may take so long \[ms\]; its size follows.
const BUDGET_MS: f64 = 70.0;
/// A scene that stands still is drawn again so often, ever finer.
const REFINEMENTS: u32 = 3;
/// Smallest share of the window's pixels across.
const COARSEST: f64 = 0.25;

/// What pictures are drawn with.
struct Drawing<'a> {
    pool: &'a ThreadPool,
    renderer: Renderer,
    /// Of the window's pixels across while the scene moves.
    share: f64,
}

fn watch(shared: &Shared, pool: &ThreadPool) {
    yield_to_loops();
    let mut drawing = Drawing {
        pool,
        renderer: Renderer::fastest(),
        share: COARSEST,
    };
    while let Some(patient) = next_patient(shared) {
        let result = watch_patient(shared, &mut drawing, &patient);
        if let Err(error) = result {
            show(shared, fault(&format!("{error:#}")));
            // Until another patient comes.
            let mut wish = lock(&shared.wish);
            if wish
                .patient
                .as_ref()
                .is_some_and(|p| Arc::ptr_eq(p, &patient))
            {
                wish.patient = None;
            }
        }
    }
}

fn fault(text: &str) -> Seen {
    Seen {
        image: ColorImage::filled([1, 1], Color32::BLACK),
        camera: Camera::look_at([0.0; 3], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], 30.0),
        ms: 0.0,
        fault: Some(text.to_owned()),
    }
}

fn show(shared: &Shared, seen: Seen) {
    *lock(&shared.seen) = Some(seen);
    (shared.wake)();
}

/// Waits for a patient to look at; `None` at the end.
fn next_patient(shared: &Shared) -> Option<Arc<Ready>> {
    let mut wish = lock(&shared.wish);
    loop {
        if wish.is_over {
            return None;
        }
        if let (Some(patient), Some(_)) = (&wish.patient, &wish.look) {
            return Some(patient.clone());
        }
        wish = shared
            .changed
            .wait(wish)
            .unwrap_or_else(PoisonError::into_inner);
    }
}

/// Draws until another patient is wished for, or the end.
fn watch_patient(shared: &Shared, drawing: &mut Drawing, patient: &Arc<Ready>) -> Result<()> {
    let mut skinner = Skinner::new(&patient.prepared);
    let scenery = Scenery::new(&patient.prepared, &patient.scenario, skinner.sawn()?)?;
    let dresser = Dresser::default();
    std::thread::scope(|scope| {
        let _closing = dresser.closing();
        Builder::new()
            .name("skins".into())
            .spawn_scoped(scope, || {
                yield_to_loops();
                dresser.work(skinner);
            })?;
        watch_scene(shared, drawing, patient, scenery, &dresser)
    })
}

fn watch_scene(
    shared: &Shared,
    drawing: &mut Drawing,
    patient: &Arc<Ready>,
    mut scenery: Scenery,
    dresser: &Dresser,
) -> Result<()> {
    let mut drawn: Option<(Look, u64, usize)> = None;
    let mut refinement = 0;
    loop {
        let wished = {
            let wish = lock(&shared.wish);
            let is_other = |p: &Arc<Ready>| !Arc::ptr_eq(p, patient);
            if wish.is_over || wish.patient.as_ref().is_none_or(is_other) {
                return Ok(());
            }
            wish.look
        };
        let Some(wished) = wished else { return Ok(()) };
        if let Some((dressed, wanted)) = dresser.take()? {
            scenery.dress(dressed, wanted.bone.as_deref())?;
        }
        let revision = look(&shared.live).revision;
        let shown = (wished, revision, scenery.generation());
        if drawn != Some(shown) {
            refinement = 0;
        } else if refinement < REFINEMENTS {
            refinement += 1;
        } else {
            let wish = lock(&shared.wish);
            // A change of the session is looked for, one of the wish wakes.
            let _ = shared.changed.wait_timeout(wish, Duration::from_millis(15));
            continue;
        }
        let (across, samples) = match refinement {
            0 => (drawing.share, 1),
            1 => ((2.0 * drawing.share).min(1.0), 1),
            2 => (1.0, 1),
            _ => (1.0, 2),
        };
        let moment = moment(&mut scenery, dresser, shared, patient, &wished)?;
        let start = Instant::now();
        let image = drawing.draw(&moment, &wished, across, samples);
        let ms = start.elapsed().as_secs_f64() * 1e3;
        if refinement == 0 {
            let change = (BUDGET_MS / ms.max(1.0)).sqrt().clamp(0.7, 1.2);
            drawing.share = (drawing.share * change).clamp(COARSEST, 1.0);
        }
        drawn = Some(shown);
        let image = to_egui(&image);
        let camera = wished.camera;
        show(
            shared,
            Seen {
                image,
                camera,
                ms,
                fault: None,
            },
        );
    }
}

fn moment(
    scenery: &mut Scenery,
    dresser: &Dresser,
    shared: &Shared,
    patient: &Ready,
    wished: &Look,
) -> Result<Moment> {
    let (time, hands, bone, growth) = {
        let live = look(&shared.live);
        let hands = live.hands.map(|h| h.hands);
        (live.time, hands, live.bone.clone(), live.growth.clone())
    };
    // A state may be a growth ahead of what is told of growths: it is shown once that has come.
    let bone = bone.filter(|b| b.generation < growth.len() as u64);
    let hands = hands.unwrap_or_else(|| patient.start.map(at_rest));
    let shown = Shown {
        time,
        bone: bone.as_deref(),
        hands: hands.each_ref(),
        apart: wished.apart,
        shows_tools: true,
        shows_loads: wished.shows_loads,
        shows_head: wished.shows_head,
    };
    if !scenery.suits(bone.as_deref()) {
        let bone = bone.clone();
        dresser.want(Wanted { bone, growth });
    }
    scenery.moment(&shown)
}

/// A hand that holds its chisel still and feels nothing.
fn at_rest(pose: Pose) -> HandSample {
    HandSample {
        device_pose: pose,
        device_buttons: 0,
        tool_pose: pose,
        wrench: Wrench::default(),
        saturated: false,
        contacts: 0,
    }
}

impl Drawing<'_> {
    fn draw(&mut self, moment: &Moment, wished: &Look, across: f64, samples: usize) -> Image {
        let scene = moment.scene();
        let [width, height] = wished
            .size
            .map(|n| ((n as f64 * across).round() as usize).clamp(16, 4096));
        let options = Options {
            width,
            height,
            samples,
            is_transparent: wished.is_transparent,
        };
        let (pool, renderer) = (self.pool, &mut self.renderer);
        let mut image = |camera: &Camera| pool.install(|| renderer.image(&scene, camera, &options));
        let Some(stereo) = wished.stereo else {
            return image(&wished.camera);
        };
        // Rows are told apart by a polarised monitor as they are on the screen, whatever was drawn.
        let views = stereo.views(&wished.camera, moment.eyes());
        let seen = views.iter().map(|c| enlarged(image(c), wished.size));
        stereo.join(&seen.collect::<Vec<_>>())
    }
}

fn enlarged(image: Image, [width, height]: [usize; 2]) -> Image {
    if [image.width, image.height] == [width, height] {
        return image;
    }
    let pixel = |i: usize| {
        let (x, y) = (i % width, i / width);
        image.pixels[y * image.height / height * image.width + x * image.width / width]
    };
    Image {
        width,
        height,
        pixels: (0..width * height).map(pixel).collect(),
    }
}

fn to_egui(image: &Image) -> ColorImage {
    let color = |p: &[u8; 4]| Color32::from_rgb(p[0], p[1], p[2]);
    ColorImage::new(
        [image.width, image.height],
        image.pixels.iter().map(color).collect(),
    )
}
