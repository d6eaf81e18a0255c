// Aravis' own fake GigE Vision camera in a process of its own: foreign_camera ADDRESS SERIAL WIDTH HEIGHT
// (width and height are there so that it is called as stamped_camera is). Prints "ready" once it serves.
#include <cstdio>

#include <arv.h>
#include <unistd.h>

int main(int argc, char** argv) {
  if (argc < 3) return 2;
  ArvGvFakeCamera* camera = arv_gv_fake_camera_new(argv[1], argv[2]);
  if (camera == nullptr || !arv_gv_fake_camera_is_running(camera)) return 1;
  std::printf("ready\n");
  std::fflush(stdout);
  for (;;) pause();
}
