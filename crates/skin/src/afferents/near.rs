//! Approximates the answers to changing drives of a scene, as the search needs them.
//!
//! A [`NearEvaluator`] answers as [`simulate`](super::simulate) does, for RA afferents whose pins all touch the skin, with these
//! differences:
//!
//! - Influences of a motor on an afferent below `min_share` of the largest count as 0.
//! - Delays of waves are approximated by their first two terms (`influence`).
//! - Numbers are `f32`, and noise is in steps of 1/30 SD. The deviates are those of the model, computed once and kept as bytes.
//! - An afferent whose membrane stays 4 SD of its noise below the threshold is silent (`near_row`, `waveform`).
//!
//! So two answers differ only by the drives, as in the model, and an afferent responds only to the motors that reach it. A
//! [`NearCandidate`] is the answer with other drives: only the afferents that a changed motor reaches are simulated again.
//! Candidates do not change the evaluator: several threads may evaluate them on one evaluator, and accept one of them or none.
//!
//! Invariant: the answer depends only on the scene, its drives and `min_share`, bit for bit. It does not depend on earlier drives,
//! threads, or the width of vectors.

use super::afferent::{Afferent, Class};
use super::contact::Contact;
use super::influence::{Influence, all_touch};
use super::near_group::{LANES, NearGroup, Term};
use super::near_row::{ROWS, rows};
use super::noise;
use super::scene::{Pins, Scene};
use super::stimulus::TILE;
use super::waveform::{Motion, Waveform, Waveforms, motion};
use crate::member::numbers;
use crate::scene::{Scene as MembraneScene, SceneError};
use meissner_array::pattern::Drive;
use pulp::Arch;
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};

/// A scene of RA afferents, and its approximate answer.
#[derive(Clone, Debug)]
pub struct NearEvaluator {
    finger: Arc<Finger>,
    motions: Vec<Motion>,
    /// Shared with its candidates: the pointer identifies them.
    counts: Arc<Vec<u64>>,
}

/// A [`NearEvaluator`]'s scene with other drives, and the part of the answer that changes.
#[derive(Clone, Debug)]
#[must_use]
pub struct NearCandidate {
    /// The scene of the motors.
    motors: MembraneScene,
    motions: Vec<Motion>,
    /// The counts of the drives it was made from.
    from: Arc<Vec<u64>>,
    changed: Vec<(u32, u64)>,
}

/// What does not depend on the drives.
#[derive(Debug)]
struct Finger {
    /// The scene of the motors, without drives.
    motors: MembraneScene,
    samples: usize,
    afferents: usize,
    /// The afferents, by row.
    members: [Vec<Member>; ROWS],
    waveforms: Waveforms,
}

/// An afferent.
#[derive(Debug)]
struct Member {
    number: u32,
    influence: Influence,
    /// The bits of an `i8` per sample, in whole tiles; empty in a scene without noise.
    noise: Vec<u8>,
}

/// Motors that move alike, one bit each, and their waveform.
struct Unison {
    motors: u64,
    first: u8,
    waveform: Arc<OnceLock<Waveform>>,
}

impl NearEvaluator {
    /// An evaluator with all motors at rest. The scene's drives are ignored; later drives must have an amplitude of at most
    /// `amplitude_um`. None if such drives may lift a pin off the skin.
    ///
    /// # Panics
    /// If anything but motors moves the pins, or if there are afferents other than RA.
    #[must_use]
    pub fn new(scene: &Scene, amplitude_um: f64, min_share: f64) -> Option<Self> {
        let Pins::Motors(motors) = scene.pins() else { panic!("motors move the pins of a search") };
        assert!(scene.afferents().iter().all(|of| of.class == Class::Ra), "a search asks RA afferents");
        let (pins, gains) = (scene.flat_pins(), motors.gains());
        let contact = Contact::new(&pins).expect("the pins of the array are told apart");
        if !all_touch(&contact, gains, scene.preindent_mm(), amplitude_um) {
            return None;
        }
        let samples = scene.samples() as usize;
        let padded = samples.next_multiple_of(TILE);
        let all: Vec<(u32, Afferent)> = (0..).zip(scene.afferents().iter().copied()).collect();
        let of = |chunk: &[(u32, Afferent)]| -> Vec<(usize, Member)> {
            let numbers: Vec<u32> = chunk.iter().map(|(number, _)| *number).collect();
            let noise = if scene.noise {
                noise::bytes(Arch::new(), scene.seed, &numbers, padded)
            } else {
                vec![Vec::new(); chunk.len()]
            };
            let member = |(&(number, afferent), noise): (&(u32, Afferent), Vec<u8>)| {
                let influence = Influence::new(&afferent, &pins, &contact, gains, min_share);
                (usize::from(afferent.row), Member { number, influence, noise })
            };
            chunk.iter().zip(noise).map(member).collect()
        };
        let made: Vec<_> = all.par_chunks(super::LANES).flat_map_iter(of).collect();
        let mut members = [const { Vec::new() }; ROWS];
        made.into_iter().for_each(|(row, member)| members[row].push(member));
        let finger = Finger {
            motors: motors.without_drives(*gains),
            samples,
            afferents: scene.afferents().len(),
            members,
            waveforms: Waveforms::new(samples),
        };
        let (counts, motions) = (Arc::new(vec![0; finger.afferents]), vec![Motion::new(); gains.len()]);
        Some(Self { finger: Arc::new(finger), motions, counts })
    }

    /// The answer with these drives in place of its own.
    ///
    /// # Errors
    /// If the drives are not those of a scene.
    pub fn evaluate(&self, drives: &[Drive]) -> Result<NearCandidate, SceneError> {
        self.evaluate_on(Arch::new(), drives)
    }

    /// The same on a given architecture.
    pub(super) fn evaluate_on(&self, arch: Arch, drives: &[Drive]) -> Result<NearCandidate, SceneError> {
        Ok(self.candidate(arch, self.finger.motors.with_drives(drives.to_vec())?))
    }

    fn candidate(&self, arch: Arch, motors: MembraneScene) -> NearCandidate {
        let of_motor = |motor| motion(motors.drives().iter().filter(|drive| drive.motor == motor));
        let motions: Vec<Motion> = motors.array().numbers().map(of_motor).collect();
        let pairs = self.motions.iter().zip(&motions).enumerate();
        let differing =
            pairs.filter(|(_, (old, new))| old != new).fold(0, |bits, (motor, _)| bits | 1_u64 << motor);
        let changed = self.finger.counts(arch, &motors, &motions, differing);
        NearCandidate { motors, motions, from: Arc::clone(&self.counts), changed }
    }

    /// Makes a candidate's drives the current drives. A candidate that was made from earlier drives is simulated again.
    pub fn accept(&mut self, candidate: NearCandidate) {
        let current = Arc::ptr_eq(&candidate.from, &self.counts);
        let candidate = if current { candidate } else { self.candidate(Arch::new(), candidate.motors) };
        let NearCandidate { motions, from, changed, .. } = candidate;
        // Drop the second owner, so that `make_mut` copies nothing.
        drop(from);
        self.motions = motions;
        let counts = Arc::make_mut(&mut self.counts);
        changed.into_iter().for_each(|(number, count)| counts[number as usize] = count);
    }

    /// Each afferent's approximate number of spikes.
    #[must_use]
    pub fn counts(&self) -> &[u64] {
        &self.counts
    }
}

impl NearCandidate {
    /// The number of afferents that a changed motor reaches.
    #[must_use]
    pub fn simulated(&self) -> usize {
        self.changed.len()
    }

    /// Each afferent's approximate number of spikes.
    #[must_use]
    pub fn counts(&self) -> Vec<u64> {
        let mut counts = Vec::clone(&self.from);
        self.changed.iter().for_each(|&(number, count)| counts[number as usize] = count);
        counts
    }
}

impl Finger {
    /// The numbers and counts of the afferents that these motors reach, given as one bit each.
    fn counts(
        &self,
        arch: Arch,
        motors: &MembraneScene,
        motions: &[Motion],
        differing: u64,
    ) -> Vec<(u32, u64)> {
        let unisons = self.unisons(motions);
        let waveforms: Vec<(u64, &Waveform)> = unisons
            .iter()
            .map(|of| (of.motors, self.waveforms.fill(&of.waveform, motors, of.first)))
            .collect();
        let mut counts = Vec::new();
        for (row, members) in self.members.iter().enumerate() {
            let mut packed = Packed::new(self, row, &waveforms);
            for member in members.iter().filter(|member| member.influence.motors & differing != 0) {
                if !packed.push(member) {
                    counts.push((member.number, 0));
                }
                packed.run_if(arch, LANES, &mut counts);
            }
            packed.run_if(arch, 1, &mut counts);
        }
        counts
    }

    /// The motors that move, by their motion, in the order of their first motor.
    fn unisons(&self, motions: &[Motion]) -> Vec<Unison> {
        let mut unisons: Vec<Unison> = Vec::new();
        for (motor, motion) in motions.iter().enumerate().filter(|(_, motion)| !motion.is_empty()) {
            let alike = |of: &&mut Unison| motions[usize::from(of.first)] == *motion;
            match unisons.iter_mut().find(alike) {
                Some(unison) => unison.motors |= 1 << motor,
                None => {
                    let waveform = self.waveforms.of(motion);
                    unisons.push(Unison { motors: 1 << motor, first: motor as u8, waveform });
                }
            }
        }
        unisons
    }
}

/// Afferents of one row that wait to be simulated together.
struct Packed<'p> {
    finger: &'p Finger,
    row: usize,
    waveforms: &'p [(u64, &'p Waveform)],
    terms: Vec<Term<'p>>,
    numbers: Vec<u32>,
    noise: Vec<&'p [u8]>,
}

impl<'p> Packed<'p> {
    fn new(finger: &'p Finger, row: usize, waveforms: &'p [(u64, &'p Waveform)]) -> Self {
        let terms = waveforms.iter().map(|(_, waveform)| Term::new(waveform.column(row))).collect();
        Self { finger, row, waveforms, terms, numbers: Vec::new(), noise: Vec::new() }
    }

    /// Takes an afferent. False if it is silent for any noise.
    fn push(&mut self, member: &'p Member) -> bool {
        let lane = self.numbers.len();
        let mut peak = 0.0;
        for (term, (motors, waveform)) in self.terms.iter_mut().zip(self.waveforms) {
            let (mut now, mut before) = (0.0, 0.0);
            for motor in numbers(motors & member.influence.motors) {
                let [of_now, of_before] = member.influence.weights[motor];
                now += of_now;
                before += of_before;
            }
            term.set(lane, now, before);
            peak += waveform.peak(self.row, now + before);
        }
        if peak < rows()[self.row].quiet {
            return false;
        }
        self.numbers.push(member.number);
        self.noise.push(&member.noise);
        true
    }

    /// Simulates the afferents if there are at least so many.
    fn run_if(&mut self, arch: Arch, least: usize, counts: &mut Vec<(u32, u64)>) {
        if self.numbers.len() < least {
            return;
        }
        // Lanes without an afferent stay at rest.
        for lane in self.numbers.len()..LANES {
            self.terms.iter_mut().for_each(|term| term.set(lane, 0.0, 0.0));
        }
        let (row, samples) = (&rows()[self.row], self.finger.samples);
        let group = NearGroup { row, terms: &self.terms, noise: &self.noise, samples };
        let found = group.counts(arch);
        counts.extend(self.numbers.drain(..).zip(found).map(|(number, count)| (number, count.into())));
        self.noise.clear();
    }
}
