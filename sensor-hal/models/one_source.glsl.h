// What a shader includes before the model files: the shared subset over float.
#ifndef RIGOR_ONE_SOURCE_GLSL_H
#define RIGOR_ONE_SOURCE_GLSL_H
#define REAL float
#define UINT uint
#define OUT(type) out type
#define FN
#define PHILOX_MUL(a, b, hi, lo) umulExtended(a, b, hi, lo)
#endif
