// Philox 4x32-10 (Salmon, Moraes, Dror, Shaw: "Parallel random numbers: as easy as 1, 2, 3", SC 2011): a counter
// goes in, four words of noise come out. Bit-equal in GLSL and C++. Subset and inclusion: see opencv_lens.glsl.h;
// UINT is the 32-bit unsigned type and PHILOX_MUL(a, b, hi, lo) the 32 x 32 -> 64 bit product.
//
// Rigor's counter is (element, effect, capture index low, capture index high), its key the first two words of
// philox((channel, 0, 0, 0), seed): see models/philox.h. Fixed patterns use capture index 0.
FN void philox4x32_10(UINT c0, UINT c1, UINT c2, UINT c3, UINT k0, UINT k1, OUT(UINT) r0, OUT(UINT) r1,
                      OUT(UINT) r2, OUT(UINT) r3) {
  for (int i = 0; i < 10; ++i) {
    UINT hi0 = UINT(0);
    UINT lo0 = UINT(0);
    UINT hi1 = UINT(0);
    UINT lo1 = UINT(0);
    PHILOX_MUL(UINT(0xD2511F53u), c0, hi0, lo0);
    PHILOX_MUL(UINT(0xCD9E8D57u), c2, hi1, lo1);
    c0 = hi1 ^ c1 ^ k0;
    c1 = lo1;
    c2 = hi0 ^ c3 ^ k1;
    c3 = lo0;
    k0 = k0 + UINT(0x9E3779B9u);
    k1 = k1 + UINT(0xBB67AE85u);
  }
  r0 = c0;
  r1 = c1;
  r2 = c2;
  r3 = c3;
}
