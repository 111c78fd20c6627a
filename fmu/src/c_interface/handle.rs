//! The handle of a tool: an instance and the tool's callback for messages, behind a pointer.

use std::ffi::{CStr, CString, c_char, c_int, c_void};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::Path;

use crate::contents::read;
use crate::description::LOG_CATEGORY;
use crate::instance::{CallError, Instance};

/// `fmi3Status`.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    Ok = 0,
    Error = 3,
    Fatal = 4,
}

/// `fmi3LogMessageCallback`, which a tool may leave null.
pub type LogMessage = Option<unsafe extern "C" fn(*mut c_void, c_int, *const c_char, *const c_char)>;

/// The target of an `fmi3Instance` pointer.
pub struct Handle {
    pub instance: Instance,
    listener: Listener,
}

/// The receiver of messages.
pub struct Listener {
    pub environment: *mut c_void,
    pub log: LogMessage,
    /// Whether messages are switched on.
    pub on: bool,
}

impl Listener {
    pub fn tell(&self, status: Status, text: &str) {
        let (Some(log), true) = (self.log, self.on) else { return };
        // A text with a zero would be an error of this program; it is then left out and not cut.
        let (Ok(category), Ok(text)) = (CString::new(LOG_CATEGORY), CString::new(text)) else { return };
        // SAFETY: the standard requires the tool to keep the callback and its environment valid as long as the
        // instance is; both texts live until the call returns.
        unsafe { log(self.environment, status as c_int, category.as_ptr(), text.as_ptr()) };
    }
}

/// A text of the tool, if it is valid UTF-8.
///
/// # Safety
/// `text` is null or points to a text that ends with a zero.
pub unsafe fn text<'a>(text: *const c_char) -> Option<&'a str> {
    if text.is_null() {
        return None;
    }
    // SAFETY: guaranteed by the caller.
    unsafe { CStr::from_ptr(text) }.to_str().ok()
}

/// The first `count` values at `start`; empty for a null pointer.
///
/// # Safety
/// `start` is null, or `count` values can be read there until the caller returns.
pub unsafe fn values<'a, T>(start: *const T, count: usize) -> &'a [T] {
    if start.is_null() || count == 0 {
        return &[];
    }
    // SAFETY: guaranteed by the caller.
    unsafe { std::slice::from_raw_parts(start, count) }
}

/// As [`values`], for writing.
///
/// # Safety
/// `start` is null, or `count` values can be written there until the caller returns, by nobody else.
pub unsafe fn values_mut<'a, T>(start: *mut T, count: usize) -> &'a mut [T] {
    if start.is_null() || count == 0 {
        return &mut [];
    }
    // SAFETY: guaranteed by the caller.
    unsafe { std::slice::from_raw_parts_mut(start, count) }
}

/// Makes an instance from the archive's resources; errors are reported to `listener`.
pub fn instantiate(resources: Option<&str>, token: Option<&str>, listener: Listener) -> *mut Handle {
    let made = catch_unwind(|| {
        let resources =
            resources.ok_or("the tool gives no folder of resources, which contains the vehicle file")?;
        let (vehicle, settings) =
            read(Path::new(resources), token.unwrap_or_default()).map_err(|e| e.to_string())?;
        Instance::new(vehicle, settings).map_err(|e| e.to_string())
    });
    match made {
        Ok(Ok(instance)) => Box::into_raw(Box::new(Handle { instance, listener })),
        Ok(Err(reason)) => {
            listener.tell(Status::Error, &reason);
            std::ptr::null_mut()
        }
        Err(_) => std::ptr::null_mut(),
    }
}

/// Calls a function on an instance. An error is reported to the tool. A panic, which must not reach C, ends the
/// instance.
///
/// # Safety
/// `handle` is null or comes from [`instantiate`], is not freed, and no other call uses it now.
pub unsafe fn with(handle: *mut Handle, call: impl FnOnce(&mut Instance) -> Result<(), CallError>) -> Status {
    // SAFETY: guaranteed by the caller.
    let Some(handle) = (unsafe { handle.as_mut() }) else { return Status::Error };
    match catch_unwind(AssertUnwindSafe(|| call(&mut handle.instance))) {
        Ok(Ok(())) => Status::Ok,
        Ok(Err(error)) => {
            handle.listener.tell(Status::Error, &error.to_string());
            Status::Error
        }
        Err(_) => Status::Fatal,
    }
}

/// Switches messages on or off.
///
/// # Safety
/// As [`with`].
pub unsafe fn set_logging(handle: *mut Handle, on: bool) -> Status {
    // SAFETY: guaranteed by the caller.
    let Some(handle) = (unsafe { handle.as_mut() }) else { return Status::Error };
    handle.listener.on = on;
    Status::Ok
}
