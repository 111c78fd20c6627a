//! The harness of test programs whose tests need prerequisites that not every machine has: measured data, a Python with
//! public packages, the right to create network namespaces.
//!
//! The standard harness decides at compile time which tests are ignored. Here a test returns an [`Outcome`] and passes
//! a missing prerequisite up with `?`: the test is then reported as `ignored`, with the reason. Where the environment
//! variable `CI` is set it fails instead and says what to install; only what that machine can never have is ignored
//! there too.
//!
//! A test that fails while the machine's processors were given to others is repeated, see [`undisturbed`]; one in real time
//! that fails beside others is repeated at the end, alone.
//!
//! A test program gets its `main` from [`tests!`](crate::tests), or from [`suites!`](crate::suites) for modules of which
//! each [lists](crate::listed) its tests: programs that are started anew for every file take longer to link, and the
//! processors idle at the end of each. Or it calls [`run`] from a `main` of its own, which may first check whether the
//! process was started as a child of a test. Every option of the standard harness works.

mod beside;
mod betaflight;
mod noise;
mod prerequisite;
mod undisturbed;

use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::{Duration, Instant};

use libtest_mimic::{Arguments, Completion, Failed, Trial};

use beside::{Kind, Lanes};
pub use betaflight::{Betaflight, betaflight_sitl};
pub use noise::noise;
pub use prerequisite::{Missing, browser, data, python, python_with};
pub use undisturbed::in_real_time;
use undisturbed::{undisturbed, wait_for_rest};

/// Tests that take longer are told with their time: they decide how long the whole suite takes.
const LONG: Duration = Duration::from_secs(5);

/// The result of a test: nothing, or the prerequisite that the machine lacks. A failure is a panic, as in any
/// test.
pub type Outcome = Result<(), Missing>;

/// A test and its name.
pub struct Test {
    name: String,
    kind: Kind,
    body: Box<dyn Fn() -> Outcome + Send>,
}

impl Test {
    /// A test that returns nothing or an [`Outcome`].
    pub fn new<R: IntoOutcome>(name: &str, body: impl Fn() -> R + Send + 'static) -> Self {
        Self {
            name: name.replace(' ', ""),
            kind: Kind::default(),
            body: Box::new(move || body().into_outcome()),
        }
    }

    /// This test, which uses something that only one test at a time may use; [`run_waiting`] runs others meanwhile.
    #[must_use]
    pub fn using(mut self, name: &'static str) -> Self {
        self.kind = Kind::Using(name);
        self
    }

    /// This test, which others disturb so much that [`run_waiting`] runs it alone, at the end.
    #[must_use]
    pub fn alone(mut self) -> Self {
        self.kind = Kind::Alone;
        self
    }

    /// This test, named after the module in which it is.
    #[must_use]
    pub fn of(mut self, module: &str) -> Self {
        self.name = format!("{module}::{}", self.name);
        self
    }
}

/// What the body of a test may return.
pub trait IntoOutcome {
    /// Converts to an outcome.
    ///
    /// # Errors
    /// The prerequisite that the machine lacks.
    fn into_outcome(self) -> Outcome;
}

impl IntoOutcome for () {
    fn into_outcome(self) -> Outcome {
        Ok(())
    }
}

impl IntoOutcome for Outcome {
    fn into_outcome(self) -> Outcome {
        self
    }
}

/// Runs the tests that the command line selects: one more at a time than there are processors, because the processes of a
/// bench wait for each other for a fifth of their time.
pub fn run(tests: Vec<Test>) -> ExitCode {
    let mut arguments = Arguments::from_args();
    arguments.test_threads.get_or_insert(processors() + 1);
    run_with(&arguments, tests, |_, _, test| undisturbed(test))
}

/// Runs tests that wait for most of their time, for a flight in real time or a time limit to end: twice as many at a time
/// as there are processors. What fails beside others is run again at the end, alone.
pub fn run_waiting(tests: Vec<Test>) -> ExitCode {
    let mut arguments = Arguments::from_args();
    let lanes = Lanes::new(arguments.test_threads.unwrap_or(2 * processors()), wait_for_rest);
    // Every test has a thread, in which it waits for its lane.
    arguments.test_threads = Some(tests.len());
    run_with(&arguments, tests, move |place, kind, test| undisturbed(|| lanes.run((place, kind), test)))
}

fn processors() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Runs each test by `how`, which gets its place in the list and its kind.
fn run_with(
    arguments: &Arguments,
    tests: Vec<Test>,
    how: impl Fn(usize, Kind, &dyn Fn() -> Outcome) -> Outcome + Send + Sync + 'static,
) -> ExitCode {
    let in_ci = std::env::var_os("CI").is_some_and(|value| !value.is_empty());
    let how = Arc::new(how);
    let trials = tests
        .into_iter()
        .enumerate()
        .map(|(place, Test { name, kind, body })| {
            let how = how.clone();
            Trial::ignorable_test(name.clone(), move || {
                judged(how(place, kind, &|| told_if_long(&name, &body)), in_ci)
            })
        })
        .collect();
    libtest_mimic::run(arguments, trials).exit_code()
}

/// Runs a test once, and says so if it took [`LONG`].
fn told_if_long(name: &str, body: &dyn Fn() -> Outcome) -> Outcome {
    let begun = Instant::now();
    let ended = catch_unwind(AssertUnwindSafe(body));
    let took = begun.elapsed();
    if took > LONG {
        let failed = if ended.is_err() { " and failed" } else { "" };
        println!("{name} took {:.0} s{failed}", took.as_secs_f64());
    }
    ended.unwrap_or_else(|failure| resume_unwind(failure))
}

fn judged(outcome: Outcome, in_ci: bool) -> Result<Completion, Failed> {
    match outcome {
        Ok(()) => Ok(Completion::Completed),
        Err(missing) if in_ci && missing.can_be_installed() => {
            Err(format!("CI is set, but there is {missing}").into())
        }
        Err(missing) => Ok(Completion::ignored_with(missing)),
    }
}

/// The `main` of a test program, with the names of its tests.
#[macro_export]
macro_rules! tests {
    ($($test:path),+ $(,)?) => {
        fn main() -> ::std::process::ExitCode {
            $crate::run(vec![$($crate::Test::new(stringify!($test), $test)),+])
        }
    };
}

/// The tests of a module, for [`suites!`](crate::suites).
#[macro_export]
macro_rules! listed {
    ($($test:path),+ $(,)?) => {
        pub fn tests() -> Vec<$crate::Test> {
            vec![$($crate::Test::new(stringify!($test), $test)),+]
        }
    };
}

/// The tests of a module which all use what only one test at a time may use, for [`suites!`](crate::suites).
#[macro_export]
macro_rules! listed_one_at_a_time {
    ($uses:literal: $($test:path),+ $(,)?) => {
        pub fn tests() -> Vec<$crate::Test> {
            vec![$($crate::Test::new(stringify!($test), $test).using($uses)),+]
        }
    };
}

/// The tests of a module which others disturb so much that they run alone, for [`suites!`](crate::suites).
#[macro_export]
macro_rules! listed_alone {
    ($($test:path),+ $(,)?) => {
        pub fn tests() -> Vec<$crate::Test> {
            vec![$($crate::Test::new(stringify!($test), $test).alone()),+]
        }
    };
}

/// The `main` of a test program: the modules whose tests start in this order, by [`run`] or [`run_waiting`].
#[macro_export]
macro_rules! suites {
    ($run:path: $($module:ident),+ $(,)?) => {
        fn main() -> ::std::process::ExitCode {
            let mut tests = Vec::new();
            $(tests.extend($module::tests().into_iter().map(|test| test.of(stringify!($module))));)+
            $run(tests)
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    fn told(outcome: Outcome, in_ci: bool) -> String {
        match judged(outcome, in_ci) {
            Ok(Completion::Completed) => "ok".into(),
            Ok(Completion::Ignored { reason }) => format!("ignored, {}", reason.unwrap_or_default()),
            Err(failed) => format!("FAILED, {}", failed.message().unwrap_or_default()),
        }
    }

    #[test]
    fn what_is_missing_is_ignored_here_and_fails_in_ci_unless_it_can_never_be_there() {
        let tool = || Err(Missing::installable("no tool", "install it"));
        assert_eq!(told(tool(), false), "ignored, no tool: install it");
        assert_eq!(told(tool(), true), "FAILED, CI is set, but there is no tool: install it");
        for in_ci in [false, true] {
            let right = Err(Missing::beyond_this_machine("no right", "the kernel refuses"));
            assert_eq!(told(right, in_ci), "ignored, no right: the kernel refuses");
            assert_eq!(told(Ok(()), in_ci), "ok");
        }
    }

    #[test]
    fn the_name_of_a_test_is_its_path() {
        assert_eq!(Test::new("flow :: order", || ()).name, "flow::order");
    }
}
