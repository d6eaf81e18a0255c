// What every backend has to do: its sources, its sinks and its emulators.
#pragma once

#include "sensor-hal/conformance/lifecycle_conformance.h"
#include "sensor-hal/conformance/source_conformance.h"
