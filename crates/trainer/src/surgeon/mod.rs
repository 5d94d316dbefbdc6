//! The built-in surgeon: target poses for two hands, out of what can be seen and felt.
//!
//! Seen: the chisels, the crack front and whether the bone is apart ([`CrackView`]). Felt: the displayed wrenches. Both chisels go into
//! the line, twist in opposite directions, follow the crack down, are driven as wedges where it stands still, and one is
//! moved along the line to where the bone still holds. On the break the surgeon goes on for a reaction time, then
//! relaxes and withdraws. Nothing here allocates: it runs in the haptic loop.
mod line;

pub use line::{Mark, SplitLine};

use crate::scenario;
use osteotome_devices::Wrench;
use osteotome_mechanics::geometry::{Pose, Vec3};

/// What the surgeon sees of the crack.
#[derive(Clone, Debug, Default)]
pub struct CrackView {
    /// Grows by one with every growth step.
    pub generation: u64,
    /// Whether the split is complete.
    pub severed: bool,
    /// Where the bone still holds: the front's vertices inside it \[mm\].
    pub front: Vec<Vec3>,
}

/// What the surgeon sees in one step.
#[derive(Clone, Copy, Debug)]
pub struct Sight<'a> {
    /// The crack.
    pub crack: &'a CrackView,
    /// World from tool.
    pub tools: &'a [Pose; 2],
    /// How far the bone has moved at each mark of the line; empty: not at all \[mm\].
    pub line: &'a [Vec3],
}

/// What one hand is about.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Task {
    /// Coming down to the slit.
    Approach,
    /// Going into it.
    Insert,
    /// Twisting and driving after the crack.
    Split,
    /// Untwisting in place, while the other hand holds the crack open, and going deeper.
    Reseat,
    /// Untwisting and coming out, to go to another place on the line.
    Withdraw { to: f64 },
    /// Going there, outside the bone.
    Move { to: f64 },
}

/// What the surgeon is about.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    Splitting,
    /// Noticed a break; goes on until `until`.
    Reacting {
        until: f64,
    },
    /// Felt a break, sees none: holds still and looks.
    Looking {
        until: f64,
    },
    Relaxing,
    Done,
}

/// One hand's place in the osteotomy's frame.
#[derive(Clone, Copy, Debug)]
struct Hand {
    task: Task,
    /// Arc length on the line \[mm\].
    s: f64,
    /// Where the hand wants the tip: below the surface \[mm\].
    depth: f64,
    /// Where the tip is \[mm\].
    tip: f64,
    /// How far the bone has moved there, as the hand follows it \[mm\].
    shift: Vec3,
    /// About the blade's own axis \[rad\].
    twist: f64,
    /// Sense of its twist.
    sense: f64,
    /// Driven ahead of where it would follow \[mm\].
    bite: f64,
    /// The crack's depth that it last went down for \[mm\].
    reached: f64,
    /// Time of its last progress \[s\].
    progress: f64,
    /// Largest torque felt of late \[N mm\].
    torque_peak: f64,
}

/// A misfit that halves a station's worth \[mm\].
const TOLERABLE: f64 = 0.5;
/// Clearance above the bone when moving along the line, and between two blades \[mm\].
const CLEARANCE: f64 = 2.0;
/// Hands follow the moving bone with this delay \[s\]: faster than voluntary motion (8-10 Hz) they cannot.
const FOLLOWING: f64 = 0.05;
/// A tip this near to its goal is there \[mm\].
const ARRIVED: f64 = 0.05;
/// The hand goes at most this far beyond a tip that does not follow \[mm\].
const MOST_LAG: f64 = 50.0;
/// Above this share of the device's torque the bone is under strain, whatever the twist.
const STRAINED: f64 = 0.75;
/// At this share of the device's torque the surgeon twists no further.
const HOLD: f64 = 0.8;
/// Front vertices this far along the line from a blade's ends are still below it \[mm\].
const BESIDE: f64 = 1.0;
/// Front vertices this far from a blade's plane belong to another cut \[mm\].
const OFF_PLANE: f64 = 6.0;
/// Untwisting is that much faster than twisting.
const UNTWISTING: f64 = 2.0;
/// Going deeper by less than this is not worth letting go of the twist \[mm\].
const WORTH_RESEATING: f64 = 1.0;
/// While the crack runs, and so long after it was last seen to, the hands twist no further \[s\]: what drives it on is stored in the
/// bone.
const RUNNING: f64 = 0.06;
/// A torque that falls below this share of its recent peak is a break felt.
const LOSS: f64 = 0.35;
/// Below this share of the device's limit a torque tells nothing.
const TELLING: f64 = 0.25;
/// Recent: the peak fades with this time \[s\].
const FADING: f64 = 0.3;
/// How long the surgeon looks after a break that was felt but not seen \[s\].
const LOOK: f64 = 0.2;

/// The state machine.
#[derive(Clone, Debug)]
pub struct BuiltInSurgeon {
    habits: scenario::Surgeon,
    line: SplitLine,
    width: [f64; 2],
    /// Of the longer blade \[mm\].
    length: f64,
    limits: [scenario::Limits; 2],
    dt: f64,
    time: f64,
    phase: Phase,
    hands: [Hand; 2],
    generation: u64,
    /// When the crack was last seen to grow \[s\].
    ran: f64,
    /// Likewise, or when a hand began anew \[s\].
    last_growth: f64,
    last_drive: f64,
    stations: Vec<Station>,
}

impl BuiltInSurgeon {
    /// A surgeon above the line of this scenario, varied by its seed.
    pub fn new(scenario: &scenario::Scenario, line: SplitLine) -> Self {
        let mut dice = Dice(scenario.seed);
        let mut habits = scenario.surgeon.clone();
        for amount in [
            &mut habits.approach_speed,
            &mut habits.drive_speed,
            &mut habits.twist_rate_deg,
            &mut habits.reaction_time,
        ] {
            *amount *= 1.0 + scenario.surgeon.variation * dice.roll();
        }
        let width = [0, 1].map(|i| scenario.tool[i].chisel.width);
        let spacing = 0.5 * (width[0] + width[1]) + CLEARANCE;
        let slack = 0.5 * scenario.osteotomy.kerf;
        let length = scenario.tool[0]
            .chisel
            .length
            .max(scenario.tool[1].chisel.length);
        let start = start_stations(&line, habits.stations, &width, spacing, [slack, length]);
        let stations = stations(&line, &width, slack);
        // The left jaw is the right one's mirror image, and so is what is done to it.
        let sense = match scenario.osteotomy.side {
            scenario::Side::Right => 1.0,
            scenario::Side::Left => -1.0,
        };
        let hand = |i: usize| Hand {
            task: Task::Approach,
            s: start[i],
            depth: -habits.approach_distance,
            tip: -habits.approach_distance,
            shift: Vec3::zeros(),
            twist: 0.0,
            sense: [sense, -sense][i],
            bite: 0.0,
            reached: 0.0,
            progress: 0.0,
            torque_peak: 0.0,
        };
        Self {
            hands: [hand(0), hand(1)],
            width,
            length,
            limits: [0, 1].map(|i| scenario.tool[i].limits.clone()),
            dt: scenario.loops.dt(),
            time: 0.0,
            phase: Phase::Splitting,
            generation: 0,
            ran: f64::NEG_INFINITY,
            last_growth: 0.0,
            last_drive: 0.0,
            stations,
            habits,
            line,
        }
    }

    /// Where the hands want to be now.
    pub fn targets(&self) -> [Pose; 2] {
        [0, 1].map(|i| self.target(i))
    }

    fn target(&self, i: usize) -> Pose {
        let hand = &self.hands[i];
        let frame = self.frame(i);
        let twist = nalgebra::UnitQuaternion::from_scaled_axis(Vec3::z() * hand.twist);
        frame * Pose::from_parts(Vec3::new(0.0, 0.0, hand.depth).into(), twist)
    }

    /// The blade's frame on the bone as it has moved.
    fn frame(&self, i: usize) -> Pose {
        let mut frame = self.line.frame(self.hands[i].s, self.width[i]);
        frame.translation.vector += self.hands[i].shift;
        frame
    }

    /// Whether the hands have been withdrawn after the break.
    pub fn is_done(&self) -> bool {
        self.phase == Phase::Done
    }

    /// Advances by one haptic step, having seen bone and chisels, and felt `wrenches` (as displayed).
    pub fn step(&mut self, sight: &Sight, wrenches: &[Wrench; 2]) {
        let crack = sight.crack;
        self.time += self.dt;
        for (i, tool) in sight.tools.iter().enumerate() {
            let moved = self.line.interpolate(self.hands[i].s, sight.line);
            let hand = &mut self.hands[i];
            hand.shift += (moved - hand.shift) * (self.dt / FOLLOWING).min(1.0);
            self.hands[i].tip = (self.frame(i).inverse() * tool).translation.z;
        }
        if crack.generation != self.generation {
            self.generation = crack.generation;
            self.ran = self.time;
            self.last_growth = self.time;
            for i in 0..2 {
                self.hands[i].bite = (self.hands[i].tip - self.follow_depth(i, crack)).max(0.0);
            }
        }
        let felt_loss = self.feel(wrenches);
        self.phase = self.next_phase(crack, felt_loss);
        match self.phase {
            Phase::Splitting | Phase::Reacting { .. } => self.work(crack, wrenches),
            Phase::Relaxing => self.relax(),
            Phase::Looking { .. } | Phase::Done => {}
        }
    }

    fn feel(&mut self, wrenches: &[Wrench; 2]) -> bool {
        let keep = 1.0 - self.dt / FADING;
        let mut lost = 0;
        for ((hand, wrench), limits) in self.hands.iter_mut().zip(wrenches).zip(&self.limits) {
            let torque = wrench.torque.norm();
            hand.torque_peak = torque.max(hand.torque_peak * keep);
            let telling = hand.torque_peak > TELLING * limits.torque;
            let twisting = hand.task == Task::Split;
            lost += usize::from(twisting && telling && torque < LOSS * hand.torque_peak);
        }
        lost == 2
    }

    fn next_phase(&mut self, crack: &CrackView, felt_loss: bool) -> Phase {
        let (now, broken) = (self.time, crack.severed);
        match self.phase {
            Phase::Splitting if broken || felt_loss => Phase::Reacting {
                until: now + self.habits.reaction_time,
            },
            Phase::Reacting { until } if now >= until && broken => Phase::Relaxing,
            Phase::Reacting { until } if now >= until => Phase::Looking { until: now + LOOK },
            Phase::Looking { .. } if broken => Phase::Relaxing,
            Phase::Looking { until } if now >= until => {
                self.hands.iter_mut().for_each(|h| h.torque_peak = 0.0);
                Phase::Splitting
            }
            Phase::Relaxing if self.hands.iter().all(|h| self.is_out(h)) => Phase::Done,
            phase => phase,
        }
    }

    fn work(&mut self, crack: &CrackView, wrenches: &[Wrench; 2]) {
        for (i, wrench) in wrenches.iter().enumerate() {
            let before = self.hands[i];
            match before.task {
                Task::Approach => self.approach(i),
                Task::Insert => self.insert(i, wrench),
                Task::Split => self.split(i, crack, wrench),
                Task::Reseat => self.reseat(i, crack, wrench),
                Task::Withdraw { to } => self.withdraw(i, to),
                Task::Move { to } => self.go(i, to),
            }
        }
        self.unstick(crack, wrenches);
    }

    fn approach(&mut self, i: usize) {
        let step = self.habits.approach_speed * self.dt;
        let hand = &mut self.hands[i];
        if toward(&mut hand.depth, 0.0, step) {
            hand.task = Task::Insert;
            hand.progress = self.time;
        }
    }

    fn insert(&mut self, i: usize, wrench: &Wrench) {
        let goal = self.first_depth(i);
        let arrived = self.drive(i, goal, wrench);
        let stuck = self.time - self.hands[i].progress > self.habits.stall_time;
        if arrived || stuck {
            self.hands[i].task = Task::Split;
            self.last_growth = self.time;
        }
    }

    fn first_depth(&self, i: usize) -> f64 {
        self.habits.insert_depth * self.line.room(self.hands[i].s, self.width[i])
    }

    /// Pushes by at most one step until the tip is as deep as `goal`, as long as the force allows it.
    fn drive(&mut self, i: usize, goal: f64, wrench: &Wrench) -> bool {
        let allowed = self.has_force(i, wrench, self.habits.push_share);
        let step = self.habits.drive_speed * self.dt;
        let hand = &mut self.hands[i];
        if hand.tip >= goal - ARRIVED {
            return true;
        }
        if allowed && hand.depth - hand.tip < MOST_LAG {
            hand.progress = self.time;
            hand.depth += step;
        }
        false
    }

    fn split(&mut self, i: usize, crack: &CrackView, wrench: &Wrench) {
        let rate = self.habits.twist_rate_deg.to_radians() * self.dt;
        let most = self.habits.twist_max_deg.to_radians();
        let both = (self.hands.iter()).all(|h| matches!(h.task, Task::Split | Task::Reseat));
        // Winding up a coupling that has no more to give would only hide the break from the hand.
        let has_torque = wrench.torque.norm() < HOLD * self.limits[i].torque;
        let runs = self.time - self.ran < RUNNING;
        if both && has_torque && !runs {
            let hand = &mut self.hands[i];
            toward(&mut hand.twist, hand.sense * most, rate);
        }
        let goal = self.follow_depth(i, crack) + self.hands[i].bite;
        self.drive(i, goal.min(self.habits.max_depth), wrench);
    }

    /// How deep the tip may follow: behind the front, but as deep as the slit.
    fn follow_depth(&self, i: usize, crack: &CrackView) -> f64 {
        let behind = self.crack_depth(i, crack) - self.habits.behind_front;
        behind.max(self.first_depth(i))
    }

    /// How deep the crack goes below this blade, in its driving direction \[mm\]: as deep as a chisel ever goes where no front
    /// is left.
    fn crack_depth(&self, i: usize, crack: &CrackView) -> f64 {
        let depth = self.front_below(i, crack);
        depth.map_or(self.habits.max_depth, |d| d.min(self.habits.max_depth))
    }

    /// The least depth of the front below this blade \[mm\].
    fn front_below(&self, i: usize, crack: &CrackView) -> Option<f64> {
        let frame = self.line.frame(self.hands[i].s, self.width[i]);
        let reach = 0.5 * self.width[i] + BESIDE;
        let below = crack.front.iter().filter_map(|p| {
            let local = frame.inverse_transform_vector(&(p - frame.translation.vector));
            let is_below = local.x.abs() < reach && local.y.abs() < OFF_PLANE && local.z > 0.0;
            is_below.then_some(local.z)
        });
        below.min_by(f64::total_cmp)
    }

    /// Lets go of the twist, goes as deep as the crack allows, and twists again.
    fn reseat(&mut self, i: usize, crack: &CrackView, wrench: &Wrench) {
        let turn = UNTWISTING * self.habits.twist_rate_deg.to_radians() * self.dt;
        if !toward(&mut self.hands[i].twist, 0.0, turn) {
            self.hands[i].progress = self.time;
            return;
        }
        let arrived = self.drive(i, self.follow_depth(i, crack), wrench);
        let stuck = self.time - self.hands[i].progress > self.habits.stall_time;
        if arrived || stuck {
            self.hands[i].task = Task::Split;
            self.last_growth = self.time;
        }
    }

    fn withdraw(&mut self, i: usize, to: f64) {
        let turn = UNTWISTING * self.habits.twist_rate_deg.to_radians() * self.dt;
        let step = self.habits.approach_speed * self.dt;
        let hand = &mut self.hands[i];
        if toward(&mut hand.twist, 0.0, turn) && toward(&mut hand.depth, -CLEARANCE, step) {
            hand.task = Task::Move { to };
        }
    }

    fn go(&mut self, i: usize, to: f64) {
        let step = self.habits.approach_speed * self.dt;
        let hand = &mut self.hands[i];
        if toward(&mut hand.s, to, step) {
            hand.task = Task::Approach;
        }
    }

    /// Where the crack has stood still for a while under strain: drive both wedges on until it moves; where that is used
    /// up or the force is, move a chisel.
    fn unstick(&mut self, crack: &CrackView, wrenches: &[Wrench; 2]) {
        if !self.hands.iter().all(|h| h.task == Task::Split) {
            return;
        }
        let most = self.habits.twist_max_deg.to_radians();
        let strained = [0, 1].into_iter().all(|i| {
            self.hands[i].twist.abs() >= most
                || wrenches[i].torque.norm() > STRAINED * self.limits[i].torque
        });
        let still = self.time - self.last_growth;
        if !strained || still < self.habits.stall_time {
            return;
        }
        // Where nothing holds below a blade any more, it has nothing left to do there.
        let is_through = (0..2).any(|i| self.front_below(i, crack).is_none());
        if is_through && self.move_to_ligament(crack) {
            return;
        }
        if let Some(i) = self.deeper(crack) {
            self.hands[i].reached = self.follow_depth(i, crack);
            self.hands[i].bite = 0.0;
            self.hands[i].task = Task::Reseat;
            return;
        }
        let mut can_drive = false;
        for (i, wrench) in wrenches.iter().enumerate() {
            let has_force = self.has_force(i, wrench, self.habits.force_share);
            let step = self.habits.drive_speed * self.dt;
            let hand = &mut self.hands[i];
            if !is_through
                && has_force
                && hand.bite < self.habits.wedge
                && hand.depth - hand.tip < MOST_LAG
            {
                hand.bite += step;
                can_drive = true;
            }
        }
        if can_drive {
            self.last_drive = self.time;
        } else if self.time - self.last_drive > 2.0 * self.habits.stall_time {
            self.last_drive = self.time;
            if is_through || !self.move_to_ligament(crack) {
                self.rock();
            }
        }
    }

    /// Where nothing else is left: both hands untwist, go down again and twist the other way about.
    fn rock(&mut self) {
        for hand in &mut self.hands {
            hand.sense = -hand.sense;
            hand.bite = 0.0;
            hand.task = Task::Reseat;
        }
    }

    /// The hand that can go farthest down the crack without wedging, if it is worth the while and has not just been tried.
    fn deeper(&self, crack: &CrackView) -> Option<usize> {
        let gain = [0, 1].map(|i| {
            let hand = &self.hands[i];
            let deepest = self.follow_depth(i, crack).min(self.habits.max_depth);
            if deepest > hand.reached + WORTH_RESEATING {
                deepest - hand.tip
            } else {
                0.0
            }
        });
        let i = usize::from(gain[1] > gain[0]);
        (gain[i] > WORTH_RESEATING).then_some(i)
    }

    fn has_force(&self, i: usize, wrench: &Wrench, share: f64) -> bool {
        wrench.force.norm() < share * self.limits[i].force
    }

    /// A chisel goes to where most of what still holds is within its reach, and not tried too often: the one that does less where
    /// it is, or else the other. Says whether there is such a place.
    fn move_to_ligament(&mut self, crack: &CrackView) -> bool {
        self.last_growth = self.time;
        let worth = [0, 1].map(|i| self.worth(self.hands[i].s, i, crack));
        let idle = usize::from(worth[1] < worth[0]);
        let goal = [idle, 1 - idle]
            .into_iter()
            .find_map(|mover| self.better_place(mover, crack).map(|k| (mover, k)));
        let Some((mover, k)) = goal else {
            return false;
        };
        self.stations[k].visits += 1;
        let hand = &mut self.hands[mover];
        hand.bite = 0.0;
        hand.reached = 0.0;
        hand.task = Task::Withdraw {
            to: self.stations[k].s,
        };
        true
    }

    /// The station most worth going to for a hand, among those it can reach.
    fn better_place(&self, mover: usize, crack: &CrackView) -> Option<usize> {
        let stays = self.hands[1 - mover].s;
        let apart = 0.5 * (self.width[0] + self.width[1]) + CLEARANCE;
        let mut best = (0.0, None);
        for (k, station) in self.stations.iter().enumerate() {
            let mut places = [stays; 2];
            places[mover] = station.s;
            // Hands do not cross: a chisel that went past the other would have to go through it.
            let is_free = (station.s - stays) * (self.hands[mover].s - stays).signum() >= apart
                && self.line.shaft_distance(places, &self.width, self.length) >= apart - CLEARANCE;
            let is_elsewhere = (station.s - self.hands[mover].s).abs() > 2.0;
            let worth = self.worth(station.s, mover, crack)
                / ((1.0 + station.excess / TOLERABLE) * f64::from(1 + station.visits));
            if is_free && is_elsewhere && worth > best.0 {
                best = (worth, Some(k));
            }
        }
        best.1
    }

    /// How much of what still holds lies below a blade at `s`.
    fn worth(&self, s: f64, i: usize, crack: &CrackView) -> f64 {
        let frame = self.line.frame(s, self.width[i]);
        let is_below = |p: &&Vec3| {
            let local = frame.inverse_transform_vector(&(*p - frame.translation.vector));
            local.x.abs() < self.width[i] && local.y.abs() < self.width[i] && local.z > 0.0
        };
        crack.front.iter().filter(is_below).count() as f64
    }

    fn is_out(&self, hand: &Hand) -> bool {
        hand.twist == 0.0 && hand.depth <= -self.habits.approach_distance
    }

    fn relax(&mut self) {
        let turn = self.habits.twist_max_deg.to_radians() / self.habits.relax_time * self.dt;
        let step = self.habits.approach_speed * self.dt;
        for hand in &mut self.hands {
            // First the push ends, then the twist, then the chisel comes out.
            let resting = hand.depth <= hand.tip;
            let unwound = toward(&mut hand.twist, 0.0, turn);
            if !resting || unwound {
                toward(&mut hand.depth, -self.habits.approach_distance, 2.0 * step);
            }
        }
    }
}

/// Where the blades go in first: near the wanted shares of the ridge, far enough from each other, and above all where a
/// straight blade fits into the slit.
fn start_stations(
    line: &SplitLine,
    shares: [f64; 2],
    width: &[f64; 2],
    spacing: f64,
    [slack, length]: [f64; 2],
) -> [f64; 2] {
    const STRIDE: f64 = 0.5; // mm
    const END_CLEARANCE: f64 = 0.5; // mm
    const PER_MISFIT: f64 = 20.0; // mm of detour that a mm of misfit is worth
    let [first, last] = line.ridge();
    let wanted = shares.map(|share| line.on_ridge(share));
    let order = if wanted[1] < wanted[0] { -1.0 } else { 1.0 };
    let n = ((last - first) / STRIDE) as usize;
    let candidates: Vec<(f64, [f64; 2])> = (0..=n)
        .map(|k| {
            let s = first + STRIDE * k as f64;
            let cost = |i: usize| {
                let excess = (line.misfit(s, width[i]) - slack).max(0.0);
                // Beyond the ends of this cut a blade would stand on bone.
                let reach = 0.5 * width[i] + END_CLEARANCE;
                let beyond = (first + reach - s).max(s + reach - last).max(0.0);
                PER_MISFIT * (excess + beyond) + (s - wanted[i]).abs()
            };
            (s, [cost(0), cost(1)])
        })
        .collect();
    let mut best = (f64::INFINITY, wanted);
    for (a, cost_a) in &candidates {
        for (b, cost_b) in &candidates {
            let cost = cost_a[0] + cost_b[1];
            let is_better = order * (b - a) >= spacing && cost < best.0;
            if is_better && line.shaft_distance([*a, *b], width, length) >= spacing - CLEARANCE {
                best = (cost, [*a, *b]);
            }
        }
    }
    if best.0 < f64::INFINITY {
        return best.1;
    }
    // A ridge too short for two blades: evenly beyond its ends.
    let middle = 0.5 * (wanted[0] + wanted[1]);
    [-0.5, 0.5].map(|half| (middle + order * half * spacing).clamp(0.0, line.length()))
}

/// A place on the line where a blade may be put.
#[derive(Clone, Copy, Debug)]
struct Station {
    s: f64,
    /// By how much the slit is too crooked there for a blade \[mm\].
    excess: f64,
    /// How often it has been tried.
    visits: u32,
}

/// Stations all along the line, a few millimetres apart.
fn stations(line: &SplitLine, width: &[f64; 2], slack: f64) -> Vec<Station> {
    const STRIDE: f64 = 3.0; // mm
    let n = (line.length() / STRIDE) as usize;
    (0..=n)
        .map(|k| {
            let s = STRIDE * k as f64;
            let excess = (line.misfit(s, width[0].max(width[1])) - slack).max(0.0);
            Station {
                s,
                excess,
                visits: 0,
            }
        })
        .collect()
}

/// Moves `value` to `goal` by at most `step`; says whether it is there.
fn toward(value: &mut f64, goal: f64, step: f64) -> bool {
    let gap = goal - *value;
    if gap.abs() <= step {
        *value = goal;
        true
    } else {
        *value += step.copysign(gap);
        false
    }
}

/// splitmix64 (Steele, Lea, Flood 2014): small, seeded, the same on every machine.
struct Dice(u64);

impl Dice {
    /// Evenly from [-1, 1).
    fn roll(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^= z >> 31;
        (z >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{BSSO_LEFT, BSSO_RIGHT, Source, load};

    fn surgeon(seed: u64) -> BuiltInSurgeon {
        surgeon_on(BSSO_RIGHT, line::tests::straight(), seed)
    }

    fn surgeon_on(scenario: &str, line: SplitLine, seed: u64) -> BuiltInSurgeon {
        let source = Source::Text {
            name: "test".into(),
            text: scenario.into(),
        };
        let set = format!("seed={seed}").parse().unwrap();
        let scenario = load(&source, &[set], std::path::Path::new("/")).unwrap();
        BuiltInSurgeon::new(&scenario, line)
    }

    /// A bone whose crack front is at one depth all along and moves down while the blades are twisted far enough.
    struct FakeBone {
        view: CrackView,
        depth: f64,
        stops_at: f64,
        breaks_at: f64,
    }

    impl FakeBone {
        fn new(stops_at: f64, breaks_at: f64) -> Self {
            let mut bone = Self {
                view: CrackView::default(),
                depth: 4.0,
                stops_at,
                breaks_at,
            };
            bone.place();
            bone
        }

        fn place(&mut self) {
            let depth = self.depth;
            let front = (0..=40).filter(|i| depth < self.stops_at || *i > 34);
            self.view.front = front
                .map(|i| Vec3::new(f64::from(i), 0.0, -depth))
                .collect();
        }

        fn step(&mut self, surgeon: &BuiltInSurgeon) -> [Wrench; 2] {
            let twisted = surgeon.hands.iter().all(|h| h.twist.abs() > 0.2);
            if twisted && self.depth < self.stops_at {
                self.depth += 0.01;
                self.view.generation += 1;
                self.place();
            }
            if self.depth >= self.breaks_at {
                self.view.severed = true;
            }
            let torque = if self.view.severed { 0.0 } else { 100.0 };
            [0, 1].map(|i| Wrench {
                force: Vec3::zeros(),
                torque: Vec3::z() * (torque * surgeon.hands[i].twist),
            })
        }
    }

    fn step(surgeon: &mut BuiltInSurgeon, bone: &FakeBone, wrenches: &[Wrench; 2]) {
        let tools = surgeon.targets();
        let sight = Sight {
            crack: &bone.view,
            tools: &tools,
            line: &[],
        };
        surgeon.step(&sight, wrenches);
    }

    fn run(surgeon: &mut BuiltInSurgeon, bone: &mut FakeBone, seconds: f64) -> f64 {
        let mut wrenches = [Wrench::default(); 2];
        let mut before = surgeon.targets();
        for k in 0..(seconds * 1000.0) as usize {
            step(surgeon, bone, &wrenches);
            wrenches = bone.step(surgeon);
            let now = surgeon.targets();
            for i in 0..2 {
                let moved = (now[i].translation.vector - before[i].translation.vector).norm();
                assert!(moved < 0.05, "a jump of {moved} mm at step {k}");
                assert!(now[i].rotation.angle_to(&before[i].rotation) < 0.01);
            }
            before = now;
            if surgeon.is_done() {
                return k as f64 * 1e-3;
            }
        }
        f64::INFINITY
    }

    #[test]
    fn splits_a_bone_that_gives_way_and_withdraws() {
        let (mut surgeon, mut bone) = (surgeon(0), FakeBone::new(15.0, 14.0));
        let end = run(&mut surgeon, &mut bone, 20.0);
        assert!(end < 20.0);
        assert!(
            surgeon
                .hands
                .iter()
                .all(|h| h.twist == 0.0 && h.depth < 0.0)
        );
    }

    #[test]
    fn goes_in_before_it_twists_and_twists_against_each_other() {
        let (mut surgeon, mut bone) = (surgeon(0), FakeBone::new(5.0, 40.0));
        let mut wrenches = [Wrench::default(); 2];
        for _ in 0..4000 {
            step(&mut surgeon, &bone, &wrenches);
            wrenches = bone.step(&surgeon);
            let [left, right] = &surgeon.hands;
            if left.twist != 0.0 || right.twist != 0.0 {
                assert!(left.depth >= 3.5 && right.depth >= 3.5);
                assert!(left.twist * right.twist <= 0.0);
            }
        }
        assert!(surgeon.hands[0].twist > 0.3);
    }

    #[test]
    fn tips_stay_behind_the_front_while_it_moves() {
        let (mut surgeon, mut bone) = (surgeon(0), FakeBone::new(18.0, 40.0));
        let mut wrenches = [Wrench::default(); 2];
        while bone.depth < 17.0 {
            step(&mut surgeon, &bone, &wrenches);
            wrenches = bone.step(&surgeon);
            let allowed = (bone.depth - surgeon.habits.behind_front).max(3.6);
            assert!(surgeon.hands.iter().all(|h| h.depth <= allowed + 0.01));
        }
        assert!(surgeon.hands[0].depth > 8.0, "it followed");
    }

    #[test]
    fn bites_and_then_moves_a_chisel_to_what_still_holds() {
        let (mut surgeon, mut bone) = (surgeon(0), FakeBone::new(10.0, 40.0));
        run(&mut surgeon, &mut bone, 20.0);
        let still_holds = 35.0..=40.0;
        assert!(
            surgeon.hands.iter().any(|h| still_holds.contains(&h.s)),
            "{:?}",
            surgeon.hands
        );
    }

    /// A bone that stands still whatever is done: no chisel has a better place on a short line, so both turn the other way about.
    #[test]
    fn rocks_where_nothing_else_is_left() {
        let mut surgeon = surgeon(0);
        surgeon.stations.clear();
        let mut bone = FakeBone::new(5.0, 40.0);
        let mut senses = std::collections::BTreeSet::new();
        let mut wrenches = [Wrench::default(); 2];
        for _ in 0..30_000 {
            step(&mut surgeon, &bone, &wrenches);
            wrenches = bone.step(&surgeon);
            let twists = surgeon.hands.map(|h| h.twist);
            assert!(twists[0] * twists[1] <= 0.0, "against each other");
            senses.extend((twists[0].abs() > 0.3).then_some(twists[0] > 0.0));
        }
        assert_eq!(senses.len(), 2, "both ways");
    }

    #[test]
    fn reacts_to_the_break_within_its_reaction_time() {
        let (mut surgeon, mut bone) = (surgeon(3), FakeBone::new(15.0, 14.0));
        let mut wrenches = [Wrench::default(); 2];
        let mut broken_at = None;
        while !matches!(surgeon.phase, Phase::Relaxing) {
            step(&mut surgeon, &bone, &wrenches);
            wrenches = bone.step(&surgeon);
            if bone.view.severed {
                broken_at.get_or_insert(surgeon.time);
            }
        }
        let reaction = surgeon.time - broken_at.unwrap();
        assert!((0.05..0.08).contains(&reaction), "{reaction} s");
    }

    /// Step by step both blades on the left jaw are where those on its mirror image are: edge, shaft and tip.
    #[test]
    fn hands_on_a_mirrored_jaw_do_the_mirror_image() {
        let line = line::tests::straight();
        let mirrored = |v: Vec3| Vec3::new(v.x, -v.y, v.z);
        let mark = |m: &Mark| Mark {
            at: mirrored(m.at),
            toward: mirrored(m.toward),
            ..*m
        };
        let marks = line.marks().iter().map(mark).collect();
        let mut right = surgeon_on(BSSO_RIGHT, line, 5);
        let mut left = surgeon_on(BSSO_LEFT, SplitLine::new(marks).unwrap(), 5);
        let (mut bone, mut wrenches) = (FakeBone::new(15.0, 14.0), [Wrench::default(); 2]);
        let mut twisted: f64 = 0.0;
        while !right.is_done() {
            step(&mut right, &bone, &wrenches);
            step(&mut left, &bone, &wrenches);
            wrenches = bone.step(&right);
            for (a, b) in right.targets().iter().zip(left.targets()) {
                let off = mirrored(a.translation.vector) - b.translation.vector;
                assert!(off.norm() < 1e-9);
                for axis in [Vec3::x(), Vec3::z()] {
                    let turned = mirrored(a.rotation * axis) - b.rotation * axis;
                    assert!(turned.norm() < 1e-9, "{turned}");
                }
            }
            twisted = twisted.max(right.hands[0].twist.abs());
        }
        assert!(twisted > 0.1, "{twisted}");
    }

    #[test]
    fn seeds_differ_and_repeat() {
        let end = |seed| run(&mut surgeon(seed), &mut FakeBone::new(15.0, 14.0), 20.0).to_bits();
        assert_eq!(end(7), end(7));
        assert_ne!(end(7), end(8));
    }
}
