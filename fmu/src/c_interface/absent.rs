//! Functions that a library must have and that a vehicle has no use for: other kinds of simulation, types of which there
//! is no variable, clocks, derivatives.

use std::ffi::c_void;

use super::handle::{Handle, Status};

/// Reading or writing variables of a type of which there is none: nothing can be asked for.
macro_rules! no_variables {
    ($($name:ident),+ $(,)?) => {$(
        #[unsafe(no_mangle)]
        extern "C" fn $name(_handle: *mut Handle, _references: *const u32, count: usize) -> Status {
            if count == 0 { Status::Ok } else { Status::Error }
        }
    )+};
}

no_variables!(
    fmi3GetFloat32,
    fmi3GetInt8,
    fmi3GetUInt8,
    fmi3GetInt16,
    fmi3GetUInt16,
    fmi3GetInt32,
    fmi3GetUInt32,
    fmi3GetInt64,
    fmi3GetString,
    fmi3GetBinary,
    fmi3GetClock,
    fmi3SetFloat32,
    fmi3SetInt8,
    fmi3SetUInt8,
    fmi3SetInt16,
    fmi3SetUInt16,
    fmi3SetInt32,
    fmi3SetUInt32,
    fmi3SetInt64,
    fmi3SetString,
    fmi3SetBinary,
    fmi3SetClock,
    fmi3GetIntervalDecimal,
    fmi3GetIntervalFraction,
    fmi3GetShiftDecimal,
    fmi3GetShiftFraction,
    fmi3SetIntervalDecimal,
    fmi3SetIntervalFraction,
    fmi3SetShiftDecimal,
    fmi3SetShiftFraction,
    fmi3GetOutputDerivatives,
);

/// What the description says that the FMU cannot do. In C's calling conventions on all platforms of FMI, who calls
/// clears the arguments, so that those that are not looked at need not be declared.
macro_rules! unsupported {
    ($($name:ident),+ $(,)?) => {$(
        #[unsafe(no_mangle)]
        extern "C" fn $name(_handle: *mut Handle) -> Status {
            Status::Error
        }
    )+};
}

unsupported!(
    fmi3EnterEventMode,
    fmi3EnterStepMode,
    fmi3EnterConfigurationMode,
    fmi3ExitConfigurationMode,
    fmi3EnterContinuousTimeMode,
    fmi3GetNumberOfVariableDependencies,
    fmi3GetVariableDependencies,
    fmi3SerializedFMUStateSize,
    fmi3SerializeFMUState,
    fmi3DeserializeFMUState,
    fmi3GetDirectionalDerivative,
    fmi3GetAdjointDerivative,
    fmi3EvaluateDiscreteStates,
    fmi3UpdateDiscreteStates,
    fmi3CompletedIntegratorStep,
    fmi3SetTime,
    fmi3SetContinuousStates,
    fmi3GetContinuousStateDerivatives,
    fmi3GetEventIndicators,
    fmi3GetContinuousStates,
    fmi3GetNominalsOfContinuousStates,
    fmi3GetNumberOfEventIndicators,
    fmi3GetNumberOfContinuousStates,
    fmi3ActivateModelPartition,
);

/// The kinds of simulation that a vehicle is not exported for.
macro_rules! no_instance {
    ($($name:ident),+ $(,)?) => {$(
        #[unsafe(no_mangle)]
        extern "C" fn $name() -> *mut c_void {
            std::ptr::null_mut()
        }
    )+};
}

no_instance!(fmi3InstantiateModelExchange, fmi3InstantiateScheduledExecution);
