//! Functions of FMI 3.0 that a library must export and that a vehicle does not use: other kinds of simulation,
//! variable types that do not occur, clocks, derivatives.

use std::ffi::c_void;

use super::handle::{Handle, Status};

/// Functions that read or write variables of a type that does not occur: only empty requests are valid.
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

/// Functions that the description declares as unsupported. In the C calling conventions of all platforms of FMI
/// the caller removes the arguments, so unused ones need not be declared.
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

/// Functions for the kinds of simulation for which a vehicle is not exported.
macro_rules! no_instance {
    ($($name:ident),+ $(,)?) => {$(
        #[unsafe(no_mangle)]
        extern "C" fn $name() -> *mut c_void {
            std::ptr::null_mut()
        }
    )+};
}

no_instance!(fmi3InstantiateModelExchange, fmi3InstantiateScheduledExecution);
