const float kColumns = 16.0;
const float kRows = 3.0;
const float kElevationStep = 0.5235988;  // 30 degrees
