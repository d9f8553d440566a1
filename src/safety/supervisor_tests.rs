//! Timelines, and the exhaustive check: every reachable state of the machine under every event and step
//! of time, to any depth, by a model checker, with deliberately broken machines that it must catch.

use super::*;
use stateright::{Checker, Model, Property};

const RULES: Rules = Rules { armed_for: 5, reset_fresh: 2 };
const CENTRED: Event = Event::Arm { at_rest: true, centred: true };

/// Takes events at their periods from a fresh supervisor on; the orders.
fn timeline(events: &[(u64, Event)]) -> (Supervisor, Vec<Result<Order, Refusal>>) {
    let mut supervisor = Supervisor::new(RULES);
    let orders = events.iter().map(|&(now, event)| supervisor.handle(now, event)).collect();
    (supervisor, orders)
}

/// Events from power-on to a running sweep.
const TO_RUNNING: [(u64, Event); 4] =
    [(1, Event::Clear), (2, Event::Reset { asked: 2 }), (3, CENTRED), (4, Event::Start)];

fn running_then(more: &[(u64, Event)]) -> (Supervisor, Vec<Result<Order, Refusal>>) {
    let (supervisor, orders) = timeline(&[&TO_RUNNING, more].concat());
    (supervisor, orders[TO_RUNNING.len()..].to_vec())
}

// SR-01
#[test]
fn it_starts_faulted_and_nothing_moves_before_reset_and_arm() {
    let (supervisor, orders) = timeline(&[
        (0, Event::Start),
        (0, CENTRED),
        (0, Event::Reset { asked: 0 }),
        (1, Event::Clear),
        (1, CENTRED),
        (2, Event::Reset { asked: 2 }),
        (2, Event::Start),
        (3, CENTRED),
        (3, Event::Start),
    ]);
    let faulted = Err(Refusal::NotNow(State::Faulted));
    assert_eq!(orders[..3], [faulted, faulted, Err(Refusal::FaultPresent)]);
    assert_eq!(orders[3..5], [Ok(Order::None), faulted]);
    assert_eq!(orders[5..7], [Ok(Order::None), Err(Refusal::NotNow(State::Idle))]);
    assert_eq!(orders[7..], [Ok(Order::None), Ok(Order::Sweep)]);
    assert_eq!(supervisor.state(), State::Running);
}

// SR-02
#[test]
fn a_trip_latches_and_a_higher_one_overrides() {
    let (supervisor, orders) = running_then(&[
        (5, Event::Trip(Action::Stop)),
        (6, Event::Trip(Action::Stop)),
        (7, Event::Trip(Action::Abort)),
        (8, Event::Trip(Action::Stop)),
        (9, Event::Trip(Action::QuickStop)),
        (10, Event::Clear),
        (11, Event::Rest),
    ]);
    let orders: Vec<Order> = orders.into_iter().flatten().collect();
    let (none, abort) = (Order::None, Order::Abort);
    assert_eq!(orders, [Order::Stop, none, abort, none, Order::QuickStop, none, none]);
    assert!(supervisor.state() == State::Aborted && supervisor.latched());
}

// SR-02
#[test]
fn a_trip_during_a_requested_stop_latches_without_beginning_it_again() {
    let (supervisor, orders) = running_then(&[(5, Event::Stop), (6, Event::Trip(Action::Stop))]);
    assert_eq!(orders, [Ok(Order::Stop), Ok(Order::None)]);
    assert_eq!(supervisor.state(), State::Aborting);
    let (_, orders) = running_then(&[(5, Event::Stop), (6, Event::Trip(Action::Abort))]);
    assert_eq!(orders[1], Ok(Order::Abort));
}

// SR-04
#[test]
fn a_reset_must_be_fresh_and_come_after_the_fault() {
    let aborted = [(5, Event::Trip(Action::Abort)), (6, Event::Rest)];
    let with = |more: &[(u64, Event)]| running_then(&[&aborted, more].concat()).1.last().copied();
    let reset = |asked| Event::Reset { asked };
    assert_eq!(with(&[(7, reset(7))]), Some(Err(Refusal::FaultPresent)));
    assert_eq!(with(&[(8, Event::Clear), (9, reset(7))]), Some(Err(Refusal::NotFresh)), "asked before");
    assert_eq!(with(&[(8, Event::Clear), (12, reset(9))]), Some(Err(Refusal::NotFresh)), "too old");
    assert_eq!(with(&[(8, Event::Clear), (9, reset(10))]), Some(Err(Refusal::NotFresh)), "from ahead");
    assert_eq!(with(&[(8, Event::Clear), (12, reset(10))]), Some(Ok(Order::None)));
}

// SR-05
#[test]
fn arming_begins_where_the_table_is_measured_to_be() {
    let arm = |at_rest, centred| {
        let (supervisor, orders) =
            timeline(&[TO_RUNNING[0], TO_RUNNING[1], (3, Event::Arm { at_rest, centred })]);
        (supervisor.state(), orders[2])
    };
    assert_eq!(arm(false, true), (State::Idle, Err(Refusal::NotAtRest)));
    assert_eq!(arm(true, false), (State::Centring, Ok(Order::Centre)));
    assert_eq!(arm(true, true), (State::Armed, Ok(Order::None)));
}

// SR-06
#[test]
fn a_stop_is_obeyed_in_every_state() {
    let trip = (5, Event::Trip(Action::Stop));
    let ways: [(&[(u64, Event)], State); 9] = [
        (&[], State::Faulted),
        (&TO_RUNNING[..2], State::Idle),
        (&[TO_RUNNING[0], TO_RUNNING[1], (3, Event::Arm { at_rest: true, centred: false })], State::Centring),
        (&TO_RUNNING[..3], State::Armed),
        (&TO_RUNNING, State::Running),
        (&[&TO_RUNNING[..], &[(5, Event::Hold)]].concat(), State::Holding),
        (&[&TO_RUNNING[..], &[(5, Event::Stop)]].concat(), State::Stopping),
        (&[&TO_RUNNING[..], &[trip]].concat(), State::Aborting),
        (&[&TO_RUNNING[..], &[trip, (6, Event::Rest)]].concat(), State::Aborted),
    ];
    assert_eq!(ways.map(|(_, state)| state), State::ALL);
    for (way, state) in ways {
        let (mut supervisor, _) = timeline(way);
        assert_eq!(supervisor.state(), state);
        supervisor.handle(7, Event::Stop).expect("never refused");
        supervisor.handle(8, Event::Rest).expect("never refused");
        assert!(!supervisor.state().moves() && supervisor.state() != State::Armed, "{state:?}");
    }
}

// SR-07
#[test]
fn an_armed_table_that_is_not_started_is_disarmed() {
    let armed = &TO_RUNNING[..3];
    let after = |now| timeline(&[armed, &[(now, Event::Time)]].concat()).0.state();
    assert_eq!((after(7), after(8)), (State::Armed, State::Idle));
}

/// A machine as the checker drives it: the supervisor, or a broken one.
type Machine = fn(Supervisor, u64, Event) -> Result<(Supervisor, Order), Refusal>;

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Seen {
    supervisor: Supervisor,
    /// A trip has come whose reset, arm and start have not been asked for (in this order, 0 to 3).
    owed: u8,
    /// The condition of a trip is there, told by the events and not by the machine.
    present: bool,
    /// An abort has happened on the way.
    aborted: bool,
}

struct Check {
    machine: Machine,
}

const REACHED: [&str; 2] = ["a sweep runs", "a sweep runs again after an abort"];

/// Only ages matter to the machine, and beyond its longest rule not even those: with the present moved back
/// to the same period after every event and old times cut off, its states are finite in number.
const NOW: u64 = 100;

fn as_of_now(s: Supervisor, now: u64) -> Supervisor {
    let oldest = NOW - RULES.armed_for - RULES.reset_fresh - 1;
    let back = |time: u64| (time + NOW).saturating_sub(now).max(oldest);
    Supervisor { since: back(s.since), cleared: back(s.cleared), ..s }
}

impl Model for Check {
    type State = Seen;
    type Action = (u64, Event);

    fn init_states(&self) -> Vec<Seen> {
        let supervisor = as_of_now(Supervisor::new(RULES), NOW);
        vec![Seen { supervisor, owed: 3, present: true, aborted: false }]
    }

    fn actions(&self, _: &Seen, actions: &mut Vec<Self::Action>) {
        for wait in [0, 1, RULES.reset_fresh, RULES.reset_fresh + 1, RULES.armed_for] {
            let now = NOW + wait;
            let trips = [Action::Warn, Action::Stop, Action::Abort, Action::QuickStop].map(Event::Trip);
            let resets = [now + 1, now, now - 1, now - RULES.reset_fresh, now - RULES.reset_fresh - 1];
            let arms = [(true, true), (true, false), (false, true)];
            actions.extend(trips.map(|event| (wait, event)));
            actions.extend(resets.map(|asked| (wait, Event::Reset { asked })));
            actions.extend(arms.map(|(at_rest, centred)| (wait, Event::Arm { at_rest, centred })));
            let plain = [Event::Clear, Event::Start, Event::Hold, Event::Resume, Event::Stop];
            actions.extend(plain.map(|event| (wait, event)));
            actions.extend([Event::Rest, Event::Done, Event::Time].map(|event| (wait, event)));
        }
    }

    fn next_state(&self, seen: &Seen, (wait, event): Self::Action) -> Option<Seen> {
        let now = NOW + wait;
        let (supervisor, accepted) = match (self.machine)(seen.supervisor, now, event) {
            Ok((next, _)) => (next, true),
            Err(_) => (seen.supervisor, false),
        };
        let (mut owed, mut present) = (seen.owed, seen.present);
        match event {
            Event::Trip(action) if action.latches() => (owed, present) = (3, true),
            Event::Clear => present = false,
            Event::Reset { .. } if accepted && owed == 3 && !present => owed = 2,
            Event::Arm { .. } if accepted && owed == 2 => owed = 1,
            Event::Start if accepted && owed == 1 => owed = 0,
            _ => {}
        }
        let aborted = seen.aborted || supervisor.state == State::Aborted;
        Some(Seen { supervisor: as_of_now(supervisor, now), owed, present, aborted })
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always("never running while a fault is latched or present", |_, seen: &Seen| {
                let s = seen.supervisor;
                let free =
                    matches!(s.state, State::Running | State::Holding | State::Armed | State::Centring);
                !(free && (s.latched || seen.present))
            }),
            Property::always(
                "no way from a trip to running without reset, arm and start",
                |_, seen: &Seen| {
                    !(matches!(seen.supervisor.state, State::Running | State::Holding) && seen.owed > 0)
                },
            ),
            Property::always("a stop is reachable from everywhere", |check: &Check, seen: &Seen| {
                let stopped = (check.machine)(seen.supervisor, NOW, Event::Stop);
                let rested = stopped.and_then(|(s, _)| (check.machine)(s, NOW, Event::Rest));
                rested.is_ok_and(|(s, _)| !s.state.moves() && s.state != State::Armed)
            }),
            Property::always("a latching trip is obeyed everywhere", |check: &Check, seen: &Seen| {
                let tripped = (check.machine)(seen.supervisor, NOW, Event::Trip(Action::Abort));
                tripped.is_ok_and(|(s, order)| {
                    let was_free = seen.supervisor.state.moves() && seen.supervisor.state != State::Aborting;
                    s.latched && (!was_free || order == Order::Abort)
                })
            }),
            Property::sometimes(REACHED[0], |_, seen: &Seen| seen.supervisor.state == State::Running),
            Property::sometimes(REACHED[1], |_, seen: &Seen| {
                seen.supervisor.state == State::Running && seen.aborted
            }),
        ]
    }
}

/// States that were looked at, promises that were found broken, whether everything was reached that should be.
fn explore(machine: Machine) -> (usize, Vec<&'static str>, bool) {
    let checker = Check { machine }.checker().spawn_bfs().join();
    let found = checker.discoveries();
    let is_reached = |name: &&'static str| REACHED.contains(name);
    let broken = found.keys().copied().filter(|name| !is_reached(name)).collect();
    (checker.unique_state_count(), broken, REACHED.iter().all(|name| found.contains_key(name)))
}

// SR-03
#[test]
fn every_reachable_state_under_every_event_keeps_its_promises() {
    let (states, broken, reached) = explore(Supervisor::after);
    assert!(broken.is_empty(), "{broken:?}");
    assert!(reached && states > 100, "{states} states");
    println!("{states} states");
}

#[test]
fn broken_machines_are_caught() {
    // The latch opens by itself once the fault has gone.
    let self_clearing: Machine = |s, now, event| {
        let (next, order) = s.after(now, event)?;
        let opens = event == Event::Clear && next.state == State::Aborted;
        Ok((if opens { Supervisor { state: State::Armed, latched: false, ..next } } else { next }, order))
    };
    // A reset is believed while the fault is there.
    let credulous: Machine = |s, now, event| match event {
        Event::Reset { .. } => Supervisor { present: false, cleared: 0, ..s }.after(now, event),
        _ => s.after(now, event),
    };
    // A start right after a reset, without arming.
    let hasty: Machine = |s, now, event| match (event, s.state) {
        (Event::Start, State::Idle) => Supervisor { state: State::Armed, ..s }.after(now, event),
        _ => s.after(now, event),
    };
    // A hold that cannot be stopped.
    let deaf: Machine = |s, now, event| match (event, s.state) {
        (Event::Stop, State::Holding) => Err(Refusal::NotNow(s.state)),
        _ => s.after(now, event),
    };
    // A trip during centring is put off.
    let late: Machine = |s, now, event| match (event, s.state) {
        (Event::Trip(_), State::Centring) => Ok((s, Order::None)),
        _ => s.after(now, event),
    };
    let machines = [
        ("self-clearing", self_clearing),
        ("credulous", credulous),
        ("hasty", hasty),
        ("deaf", deaf),
        ("late", late),
    ];
    for (name, machine) in machines {
        assert!(!explore(machine).1.is_empty(), "{name} went unseen");
    }
}
