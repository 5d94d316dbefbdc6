//! How long things took.

/// Durations of one kind of step \[ms\].
#[derive(Clone, Debug, Default)]
pub struct Times(Vec<f64>);

/// Durations in short \[ms\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InShort {
    /// Arithmetic mean.
    pub mean: f64,
    /// Standard deviation.
    pub sd: f64,
    /// Shortest.
    pub min: f64,
    /// Median: what a busy machine changes least.
    pub median: f64,
    /// 99th percentile: that of rank ceil(.99 n).
    pub p99: f64,
    /// Longest.
    pub max: f64,
}

impl Times {
    /// Takes one in.
    pub fn push(&mut self, ms: f64) {
        self.0.push(ms);
    }

    /// Takes in those of others.
    pub fn append(&mut self, others: &Self) {
        self.0.extend_from_slice(&others.0);
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Sum of all \[ms\].
    pub fn sum(&self) -> f64 {
        self.0.iter().sum()
    }

    /// Mean; NaN for none \[ms\].
    pub fn mean(&self) -> f64 {
        self.sum() / self.0.len() as f64
    }

    /// All in short; nothing if there are none.
    pub fn in_short(&self) -> Option<InShort> {
        let mut sorted = self.0.clone();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| {
            let rank = (share * sorted.len() as f64).ceil() as usize;
            sorted.get(rank.max(1) - 1).copied()
        };
        let mean = self.mean();
        let square = |v: &f64| (v - mean) * (v - mean);
        Some(InShort {
            mean,
            sd: (sorted.iter().map(square).sum::<f64>() / sorted.len() as f64).sqrt(),
            min: *sorted.first()?,
            median: at(0.5)?,
            p99: at(0.99)?,
            max: *sorted.last()?,
        })
    }
}

/// The same work done our way and by a baseline, in the same situations.
#[derive(Clone, Debug)]
pub struct Pairs {
    /// The baseline in words.
    pub what: &'static str,
    ours: Times,
    baseline: Times,
    /// Wall time that the comparison has taken, results and all \[ms\].
    spent: f64,
    n_left_out: usize,
}

/// A baseline is tried no longer than this in all: those of large bones take seconds \[ms\].
const BUDGET: f64 = 12_000.0;

impl Pairs {
    /// Nothing compared yet.
    pub fn new(what: &'static str) -> Self {
        Self {
            what,
            ours: Times::default(),
            baseline: Times::default(),
            spent: 0.0,
            n_left_out: 0,
        }
    }

    /// Whether there is time left for another comparison. The first is always made.
    pub fn is_open(&self) -> bool {
        self.spent < BUDGET
    }

    /// Takes a comparison in \[ms\]; `spent`: how long it took in all.
    pub fn push(&mut self, ours: f64, baseline: f64, spent: f64) {
        self.ours.push(ours);
        self.baseline.push(baseline);
        self.spent += spent;
    }

    /// Notes a situation that cost `spent` \[ms\] and in which the two have no result in common to be compared.
    pub fn leave_out(&mut self, spent: f64) {
        self.n_left_out += 1;
        self.spent += spent;
    }

    /// How many such situations there were.
    pub fn n_left_out(&self) -> usize {
        self.n_left_out
    }

    /// How many comparisons there were.
    pub fn len(&self) -> usize {
        self.ours.len()
    }

    /// Mean time of the baseline \[ms\]; nothing if it was never tried.
    pub fn baseline_ms(&self) -> Option<f64> {
        (self.len() > 0).then(|| self.baseline.mean())
    }

    /// Baseline over ours, over the situations in which both were timed.
    pub fn ratio(&self) -> Option<f64> {
        (self.len() > 0).then(|| self.baseline.sum() / self.ours.sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_in_short() {
        let mut times = Times::default();
        assert_eq!(times.in_short(), None);
        (1..=200).rev().for_each(|k| times.push(f64::from(k)));
        let short = times.in_short().unwrap();
        assert_eq!([short.min, short.median], [1.0, 100.0]);
        assert_eq!([short.p99, short.max], [198.0, 200.0]);
        assert!((short.mean - 100.5).abs() < 1e-12);
        // Of 1 to n it is sqrt((n^2 - 1) / 12).
        assert!((short.sd - (39_999.0_f64 / 12.0).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn a_ratio_is_over_the_same_situations() {
        let mut pairs = Pairs::new("");
        assert_eq!(pairs.ratio(), None);
        pairs.push(1.0, 10.0, 0.5 * BUDGET);
        assert!(pairs.is_open());
        pairs.push(3.0, 10.0, 0.5 * BUDGET);
        assert!(!pairs.is_open());
        assert_eq!(pairs.ratio(), Some(5.0));
        assert_eq!(pairs.baseline_ms(), Some(10.0));
    }

    #[test]
    fn what_cannot_be_compared_costs_time_and_counts_for_nothing_else() {
        let mut pairs = Pairs::new("");
        pairs.leave_out(BUDGET);
        assert!(!pairs.is_open());
        assert_eq!((pairs.len(), pairs.n_left_out()), (0, 1));
        assert_eq!((pairs.baseline_ms(), pairs.ratio()), (None, None));
    }
}
