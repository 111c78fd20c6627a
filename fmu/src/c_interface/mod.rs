//! The functions that a tool calls, with the names and signatures of FMI 3.0 (`fmi3FunctionTypes.h`).
//!
//! The standard requires a tool to pass only instances that it got from `fmi3InstantiateCoSimulation` and has not
//! freed, to use one instance in one thread at a time, and to pass arrays of the stated length. Every `unsafe`
//! block here relies on that.

#![allow(non_snake_case, reason = "the standard names the functions")]

mod absent;
mod handle;

use std::ffi::{c_char, c_void};

use self::handle::{
    Handle, Listener, LogMessage, Status, instantiate, set_logging, text, values, values_mut, with,
};
use crate::instance::{CallError, Instance};

#[unsafe(no_mangle)]
extern "C" fn fmi3GetVersion() -> *const c_char {
    c"3.0".as_ptr()
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3SetDebugLogging(
    handle: *mut Handle,
    on: bool,
    _categories: usize,
    _names: *const *const c_char,
) -> Status {
    // SAFETY: see the module's head.
    unsafe { set_logging(handle, on) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3InstantiateCoSimulation(
    _name: *const c_char,
    token: *const c_char,
    resources: *const c_char,
    _visible: bool,
    logging: bool,
    _event_mode: bool,
    _early_return: bool,
    _intermediate: *const u32,
    _intermediate_count: usize,
    environment: *mut c_void,
    log: LogMessage,
    _intermediate_update: *const c_void,
) -> *mut Handle {
    // SAFETY: see the module's head.
    let (resources, token) = unsafe { (text(resources), text(token)) };
    // The reason for a missing instance is always reported, because the tool has no other information.
    let listener = Listener { environment, log, on: true };
    let handle = instantiate(resources, token, listener);
    if !handle.is_null() {
        // SAFETY: it was made above, and nobody else knows it yet.
        unsafe { set_logging(handle, logging) };
    }
    handle
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3FreeInstance(handle: *mut Handle) {
    if !handle.is_null() {
        // SAFETY: see the module's head; it was made by Box::into_raw.
        drop(unsafe { Box::from_raw(handle) });
    }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3EnterInitializationMode(
    handle: *mut Handle,
    _tolerance_defined: bool,
    _tolerance: f64,
    start: f64,
    _stop_defined: bool,
    _stop: f64,
) -> Status {
    // SAFETY: see the module's head.
    unsafe { with(handle, |instance| instance.enter_initialization(start)) }
}

/// Functions that take only an instance.
macro_rules! plain {
    ($($name:ident => $method:ident),+ $(,)?) => {$(
        #[unsafe(no_mangle)]
        unsafe extern "C" fn $name(handle: *mut Handle) -> Status {
            // SAFETY: see the module's head.
            unsafe { with(handle, Instance::$method) }
        }
    )+};
}

plain!(
    fmi3ExitInitializationMode => exit_initialization,
    fmi3Terminate => terminate,
    fmi3Reset => reset,
);

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3DoStep(
    handle: *mut Handle,
    from: f64,
    step: f64,
    _no_state_before: bool,
    event_needed: *mut bool,
    terminate: *mut bool,
    early_return: *mut bool,
    last_time: *mut f64,
) -> Status {
    let mut reached = from;
    // SAFETY: see the module's head.
    let status = unsafe {
        with(handle, |instance| {
            let done = instance.do_step(from, step);
            reached = instance.time_s();
            done
        })
    };
    for flag in [event_needed, terminate, early_return] {
        // SAFETY: see the module's head; one value behind each pointer.
        unsafe { values_mut(flag, 1) }.fill(false);
    }
    // SAFETY: as above.
    unsafe { values_mut(last_time, 1) }.fill(reached);
    status
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3GetFloat64(
    handle: *mut Handle,
    references: *const u32,
    count: usize,
    out: *mut f64,
    out_count: usize,
) -> Status {
    // SAFETY: see the module's head.
    let (references, out) = unsafe { (values(references, count), values_mut(out, out_count)) };
    // SAFETY: see the module's head.
    unsafe { with(handle, |instance| instance.floats(references, out)) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3SetFloat64(
    handle: *mut Handle,
    references: *const u32,
    count: usize,
    given: *const f64,
    given_count: usize,
) -> Status {
    // SAFETY: see the module's head.
    unsafe { each(handle, (references, count), (given, given_count), Instance::set_float) }
}

/// Functions for a type with a single variable.
macro_rules! scalar {
    ($($get:ident => $getter:ident, $set:ident => $setter:ident: $type:ty);+ $(;)?) => {$(
        #[unsafe(no_mangle)]
        unsafe extern "C" fn $get(
            handle: *mut Handle,
            references: *const u32,
            count: usize,
            out: *mut $type,
            out_count: usize,
        ) -> Status {
            // SAFETY: see the module's head.
            let (references, out) = unsafe { (values(references, count), values_mut(out, out_count)) };
            let get = |instance: &mut Instance| {
                references.iter().zip(out).try_for_each(|(r, v)| instance.$getter(*r).map(|found| *v = found))
            };
            // SAFETY: see the module's head.
            unsafe { with(handle, get) }
        }

        #[unsafe(no_mangle)]
        unsafe extern "C" fn $set(
            handle: *mut Handle,
            references: *const u32,
            count: usize,
            given: *const $type,
            given_count: usize,
        ) -> Status {
            // SAFETY: see the module's head.
            unsafe { each(handle, (references, count), (given, given_count), Instance::$setter) }
        }
    )+};
}

scalar!(
    fmi3GetUInt64 => seed, fmi3SetUInt64 => set_seed: u64;
    fmi3GetBoolean => noise, fmi3SetBoolean => set_noise: bool;
);

/// Sets one variable after the other.
///
/// # Safety
/// As [`with`]; as many references and values can be read as is said.
unsafe fn each<T: Copy>(
    handle: *mut Handle,
    (references, count): (*const u32, usize),
    (given, given_count): (*const T, usize),
    mut set: impl FnMut(&mut Instance, u32, T) -> Result<(), CallError>,
) -> Status {
    // SAFETY: as the caller has it.
    let (references, given) = unsafe { (values(references, count), values(given, given_count)) };
    let set_all = |instance: &mut Instance| {
        references.iter().zip(given).try_for_each(|(reference, value)| set(instance, *reference, *value))
    };
    // SAFETY: as the caller has it.
    unsafe { with(handle, set_all) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3GetFMUState(handle: *mut Handle, state: *mut *mut Instance) -> Status {
    let keep = |instance: &mut Instance| {
        // SAFETY: see the module's head; the pointer is null or there is one to a state of ours, or null, behind it.
        let Some(place) = (unsafe { state.as_mut() }) else { return Ok(()) };
        // SAFETY: as above; a state was made by Box::into_raw below.
        match unsafe { place.as_mut() } {
            Some(kept) => kept.clone_from(instance),
            None => *place = Box::into_raw(Box::new(instance.clone())),
        }
        Ok(())
    };
    // SAFETY: see the module's head.
    unsafe { with(handle, keep) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3SetFMUState(handle: *mut Handle, state: *const Instance) -> Status {
    // SAFETY: see the module's head; the pointer is null or a state of ours.
    let Some(kept) = (unsafe { state.as_ref() }) else { return Status::Error };
    let restore = |instance: &mut Instance| {
        instance.clone_from(kept);
        Ok(())
    };
    // SAFETY: see the module's head.
    unsafe { with(handle, restore) }
}

#[unsafe(no_mangle)]
unsafe extern "C" fn fmi3FreeFMUState(_handle: *mut Handle, state: *mut *mut Instance) -> Status {
    // SAFETY: see the module's head; the pointer is null or a state of ours.
    let Some(kept) = (unsafe { state.as_mut() }) else { return Status::Ok };
    if !kept.is_null() {
        // SAFETY: it was made by Box::into_raw in fmi3GetFMUState.
        drop(unsafe { Box::from_raw(*kept) });
        *kept = std::ptr::null_mut();
    }
    Status::Ok
}
