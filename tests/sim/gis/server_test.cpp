// WCS, WMS and WFS against a real MapServer on loopback, through a relay that can cut an answer anywhere.
#include <arpa/inet.h>
#include <fcntl.h>
#include <netinet/in.h>
#include <ogrsf_frmts.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <mutex>
#include <sstream>
#include <thread>

#include "sim/world/store/world_file.h"
#include "tests/sim/gis/gis_test_support.h"

namespace rigor::gis::test {
namespace {

namespace fs = std::filesystem;
using Kind = ImportSource::Kind;
constexpr const char* kMapServer = "/usr/lib/cgi-bin/mapserv";

int listening(int& port) {
  const int s = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in a{};
  a.sin_family = AF_INET;
  a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t n = sizeof a;
  if (::bind(s, reinterpret_cast<sockaddr*>(&a), n) != 0 || ::listen(s, 16) != 0) return -1;
  ::getsockname(s, reinterpret_cast<sockaddr*>(&a), &n);
  port = ntohs(a.sin_port);
  return s;
}

int connected(int port) {
  const int s = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in a{};
  a.sin_family = AF_INET;
  a.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  a.sin_port = htons(static_cast<std::uint16_t>(port));
  if (::connect(s, reinterpret_cast<sockaddr*>(&a), sizeof a) == 0) return s;
  ::close(s);
  return -1;
}

// Hands requests on to a server, one at a time, and its answers back; those to requests that contain a word
// can be cut after so many bytes, by an orderly end or a reset.
class Relay {
 public:
  explicit Relay(int server_port) : server_port_(server_port), socket_(listening(port)) {
    thread_ = std::jthread([this](const std::stop_token& stop) {
      while (!stop.stop_requested()) {
        const int client = ::accept(socket_, nullptr, nullptr);
        if (client < 0) return;
        serve(client);
        ::close(client);
      }
    });
  }
  ~Relay() {
    thread_.request_stop();
    ::shutdown(socket_, SHUT_RDWR);
    thread_.join();
    ::close(socket_);
  }
  void cut(std::string word, std::size_t after, bool reset, std::function<void()> then = {}) {
    const std::lock_guard lock(mutex_);
    word_ = std::move(word), after_ = after, reset_ = reset, then_ = std::move(then);
  }
  std::atomic<int> requests{0}, cuts{0};
  std::atomic<std::size_t> last_answer{0};  // bytes of the last answer to a request with the word
  int port = 0;

 private:
  void serve(int client) {
    std::string request;
    char buffer[16384];
    while (request.find("\r\n\r\n") == std::string::npos) {
      const auto n = ::recv(client, buffer, sizeof buffer, 0);
      if (n <= 0) return;
      request.append(buffer, static_cast<std::size_t>(n));
    }
    ++requests;
    std::string word;
    std::size_t after = 0;
    bool reset = false;
    std::function<void()> then;
    {
      const std::lock_guard lock(mutex_);
      word = word_, after = after_, reset = reset_, then = then_;
    }
    const bool marked =
        !word.empty() && request.substr(0, request.find('\r')).find(word) != std::string::npos;
    const int server = connected(server_port_);
    if (server < 0) return;
    [[maybe_unused]] auto sent = ::send(server, request.data(), request.size(), MSG_NOSIGNAL);
    std::size_t total = 0;
    for (ssize_t n; (n = ::recv(server, buffer, sizeof buffer, 0)) > 0;) {
      auto give = static_cast<std::size_t>(n);
      const bool now = marked && total + give > after;
      if (now) give = after > total ? after - total : 0;
      if (::send(client, buffer, give, MSG_NOSIGNAL) < 0) break;
      total += give;
      if (!now) continue;
      ++cuts;
      if (then) then();
      if (reset) {
        const linger hard{1, 0};
        ::setsockopt(client, SOL_SOCKET, SO_LINGER, &hard, sizeof hard);
      }
      break;
    }
    if (marked) last_answer = total;
    ::close(server);
  }

  int server_port_, socket_;
  std::mutex mutex_;
  std::string word_;
  std::size_t after_ = 0;
  bool reset_ = false;
  std::function<void()> then_;
  std::jthread thread_;
};

class Servers : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!fs::exists(kMapServer)) GTEST_SKIP() << "no " << kMapServer << " (package cgi-mapserver)";
    int port = 0;
    ::close(listening(port));
    relay_ = std::make_unique<Relay>(port);
    make_data();
    make_site();
    start(port);
  }
  void TearDown() override {
    stop();
    relay_.reset();
  }
  void stop() {
    if (server_ > 0) {
      ::kill(-server_, SIGKILL);
      ::waitpid(server_, nullptr, 0);
    }
    server_ = -1;
  }

  void make_data() {
    RasterSpec dem;
    dem.width = dem.height = 120;
    dem.crs = "EPSG:25832";
    dem.geotransform = {499'400, 10, 0, 5'200'600, 0, -10};
    dem.value = [](int c, int r, int) { return 500 + 0.25 * c + 0.5 * r + ((c * 7 + r * 13) % 11) * 0.125; };
    write_raster(folder_ / "dem.tif", dem);
    RasterSpec image = dem;
    image.bands = 3;
    image.type = GDT_Byte;
    image.width = image.height = 600;
    image.geotransform = {499'400, 2, 0, 5'200'600, 0, -2};
    image.value = [](int c, int r, int b) { return 1 + (c * b * 3 + r * 5) % 250; };
    write_raster(folder_ / "image.tif", image);
    auto* d = GetGDALDriverManager()->GetDriverByName("GPKG")->Create((folder_ / "b.gpkg").c_str(), 0, 0, 0,
                                                                      GDT_Unknown, nullptr);
    OGRSpatialReference crs;
    crs.importFromEPSG(25832);
    OGRLayer* layer = d->CreateLayer("buildings", &crs, wkbPolygon);
    OGRFieldDefn height("HEIGHT", OFTReal);
    layer->CreateField(&height);
    for (int i = 0; i < 60; ++i) {
      OGRFeature f(layer->GetLayerDefn());
      f.SetField("HEIGHT", 4.0 + i % 9);
      const double x = 499'600 + 40.0 * (i % 10), y = 5'199'800 + 40.0 * static_cast<int>(i / 10);
      OGRLinearRing ring;
      for (const auto& [u, v] : {std::pair{0, 0}, {12, 0}, {12, 9}, {0, 9}, {0, 0}})
        ring.addPoint(x + u, y + v);
      OGRPolygon p;
      p.addRing(&ring);
      p.flattenTo2D();
      f.SetGeometry(&p);
      ASSERT_EQ(layer->CreateFeature(&f), OGRERR_NONE);
    }
    GDALClose(d);
  }

  void make_site() {
    const std::string base = folder_.path().string();
    fs::create_directories(folder_.path() / "site" / "cgi-bin");
    fs::create_symlink(kMapServer, folder_.path() / "site" / "cgi-bin" / "mapserv");
    folder_.write(
        "site.map",
        "MAP\nNAME \"site\"\nSTATUS ON\nSIZE 400 400\nEXTENT 499400 5199400 500600 5200600\nUNITS METERS\n"
        "IMAGETYPE png24\nPROJECTION \"init=epsg:25832\" END\n"
        "OUTPUTFORMAT NAME \"png24\" DRIVER \"AGG/PNG\" MIMETYPE \"image/png\" IMAGEMODE RGB EXTENSION "
        "\"png\" TRANSPARENT OFF END\n"
        "OUTPUTFORMAT NAME \"GTiff\" DRIVER \"GDAL/GTiff\" MIMETYPE \"image/tiff\" IMAGEMODE FLOAT32 "
        "EXTENSION \"tif\" END\n"
        "WEB METADATA \"ows_title\" \"site\" \"ows_enable_request\" \"*\" \"ows_srs\" \"EPSG:25832 "
        "EPSG:4326\"\n\"ows_onlineresource\" \"" +
            address() +
            "&\" END END\n"
            "LAYER NAME \"dem\" TYPE RASTER STATUS ON DATA \"" +
            base +
            "/dem.tif\" PROJECTION \"init=epsg:25832\" END\n"
            "METADATA \"ows_title\" \"dem\" \"wcs_label\" \"dem\" \"wcs_rangeset_name\" \"height\" "
            "\"wcs_rangeset_label\" \"height\" "
            "\"wcs_formats\" \"GTiff\" \"wcs_nativeformat\" \"GTiff\" \"wcs_size\" \"120 120\" "
            "\"wcs_resolution\" \"10 10\" "
            "\"wcs_extent\" \"499400 5199400 500600 5200600\" \"wcs_bandcount\" \"1\" \"wcs_imagemode\" "
            "\"FLOAT32\" END END\n"
            "LAYER NAME \"picture\" TYPE RASTER STATUS ON DATA \"" +
            base +
            "/image.tif\" PROJECTION \"init=epsg:25832\" END METADATA \"ows_title\" \"picture\" END END\n"
            "LAYER NAME \"buildings\" TYPE POLYGON STATUS ON CONNECTIONTYPE OGR CONNECTION \"" +
            base +
            "/b.gpkg\" DATA \"buildings\" TEMPLATE \"x\"\n"
            "PROJECTION \"init=epsg:25832\" END METADATA \"ows_title\" \"buildings\" \"gml_include_items\" "
            "\"all\" \"gml_types\" \"auto\" END END\nEND\n");
    folder_.write("mapserver.conf", "CONFIG\nENV\nMS_MAP_PATTERN \"^" + base +
                                        "/[a-z]+\\.map$\"\nEND\nMAPS\nSITE \"" + base +
                                        "/site.map\"\nEND\nEND\n");
    // As root, http.server runs CGI programs as nobody.
    fs::permissions(folder_.path(), fs::perms(0755));
    for (const auto& e : fs::recursive_directory_iterator(folder_.path()))
      if (!e.is_symlink()) fs::permissions(e.path(), e.is_directory() ? fs::perms(0755) : fs::perms(0644));
  }

  void start(int port) {
    const std::string site = (folder_.path() / "site").string(), conf = folder_ / "mapserver.conf";
    server_ = ::fork();
    if (server_ == 0) {
      ::setpgid(0, 0);
      const int null = ::open("/dev/null", O_RDWR);
      ::dup2(null, 1), ::dup2(null, 2);
      if (::chdir(site.c_str()) != 0) ::_exit(1);
      ::setenv("MAPSERVER_CONFIG_FILE", conf.c_str(), 1);
      ::execlp("python3", "python3", "-m", "http.server", "--cgi", "--bind", "127.0.0.1",
               std::to_string(port).c_str(), nullptr);
      ::_exit(1);
    }
    ::setpgid(server_, server_);
    for (int i = 0; i < 1200; ++i) {
      if (const int s = connected(port); s >= 0) {
        ::close(s);
        return;
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
    FAIL() << "http.server does not answer";
  }

  std::string address() const {
    return "http://127.0.0.1:" + std::to_string(relay_->port) + "/cgi-bin/mapserv?map=SITE";
  }
  ImportPlan plan(bool dem, bool image, bool buildings, bool server,
                  const std::string& cache = "cache") const {
    ImportPlan p;
    p.anchor = Anchor{46.9530, 9.0, kNaN};
    p.half_extent_m = 300;
    p.spacing_m = 2;
    p.cache_dir = folder_.path() / cache;
    p.server_timeout_s = 10;
    const auto add = [&](Kind kind, const std::string& service, const std::string& layer,
                         const std::string& file) {
      p.sources.push_back(source(kind, server ? service + ":" + address() : folder_ / file));
      if (server) p.sources.back().layer = layer;
    };
    if (dem) add(Kind::elevation, "WCS", "dem", "dem.tif");
    if (image) {
      add(Kind::imagery, "WMS", "picture", "image.tif");
      if (server) p.sources.back().crs = "EPSG:25832";
    }
    if (buildings) {
      add(Kind::vector, "WFS", "buildings", "b.gpkg");
      p.sources.back().becomes = "building";
      p.sources.back().columns = {{"height_m", "HEIGHT"}};
    }
    if (!dem) p.anchor->height_m = 500;
    return p;
  }
  bool cache_is_empty(const std::string& cache) const {
    std::error_code ec;
    return !fs::exists(folder_.path() / cache, ec) || fs::is_empty(folder_.path() / cache, ec);
  }

  Folder folder_;
  std::unique_ptr<Relay> relay_;
  pid_t server_ = -1;
};

std::string sorted_lines(const std::string& text) {
  std::vector<std::string> lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  std::sort(lines.begin(), lines.end());
  std::string all;
  for (const auto& l : lines) all += l + "\n";
  return all;
}

TEST_F(Servers, GiveTheSameWorldAsTheFilesBehindThem) {
  for (int what = 0; what < 3; ++what) {
    const Imported files = import(plan(what == 0, what == 1, what == 2, false));
    ASSERT_TRUE(files.report) << files.complaint();
    const Imported served = import(plan(what == 0, what == 1, what == 2, true));
    ASSERT_TRUE(served.report) << what << " " << served.complaint();
    EXPECT_EQ(served.world().node_count(), files.world().node_count());
    std::string a = world::world_yaml(files.world()), b = world::world_yaml(served.world());
    EXPECT_GT(a.size(), 1000u);
    // A feature server answers in the order that it likes: the same lines, then, in whatever order.
    if (what == 2) a = sorted_lines(a), b = sorted_lines(b);
    EXPECT_TRUE(a == b) << (what == 0 ? "WCS" : what == 1 ? "WMS" : "WFS");
  }
  EXPECT_GT(relay_->requests, 0);
}

TEST_F(Servers, AreNotAskedAgainAndNotMissedOnceTheyAreGone) {
  const Imported first = import(plan(true, true, true, true));
  ASSERT_TRUE(first.report) << first.complaint();
  const int asked = relay_->requests;
  const Imported second = import(plan(true, true, true, true));
  ASSERT_TRUE(second.report) << second.complaint();
  EXPECT_EQ(relay_->requests, asked);
  stop();
  const Imported third = import(plan(true, true, true, true));
  ASSERT_TRUE(third.report) << third.complaint();
  EXPECT_EQ(world::world_yaml(first.world()), world::world_yaml(third.world()));
  auto other = plan(true, true, true, true);
  other.half_extent_m = 250;
  const Imported missing = import(other);
  ASSERT_FALSE(missing.report);
  EXPECT_EQ(missing.report.error().code, ErrorCode::unavailable) << missing.complaint();
  EXPECT_EQ(missing.world().node_count(), 0u);
}

TEST_F(Servers, ThatDieHalfWayLeaveTheWorldAndTheCacheAsTheyWere) {
  const char* const words[] = {"GetCoverage", "GetMap", "GetFeature"};
  for (int what = 0; what < 3; ++what) {
    relay_->cut(words[what], 1u << 30, false);
    const Imported whole = import(plan(what == 0, what == 1, what == 2, true, "whole"));
    ASSERT_TRUE(whole.report) << whole.complaint();
    const std::size_t bytes = relay_->last_answer;
    ASSERT_GT(bytes, 1000u) << words[what];
    for (const double share : {0.0, 0.02, 0.2, 0.5, 0.8, 0.97})
      for (const bool reset : {false, true}) {
        relay_->cuts = 0;
        relay_->cut(words[what], static_cast<std::size_t>(share * static_cast<double>(bytes)), reset);
        const Imported w = import(plan(what == 0, what == 1, what == 2, true, "cut" + std::to_string(what)));
        EXPECT_GT(relay_->cuts, 0);
        EXPECT_FALSE(w.report) << words[what] << " cut after " << share << (reset ? " by reset" : "");
        if (!w.report) {
          EXPECT_EQ(w.report.error().code, ErrorCode::unavailable) << w.complaint();
        }
        EXPECT_EQ(w.world().node_count(), 0u);
        EXPECT_TRUE(cache_is_empty("cut" + std::to_string(what))) << words[what] << " " << share;
      }
    relay_->cut("", 0, false);
    const Imported again = import(plan(what == 0, what == 1, what == 2, true, "cut" + std::to_string(what)));
    ASSERT_TRUE(again.report) << again.complaint();
    EXPECT_TRUE(world::world_yaml(again.world()) == world::world_yaml(whole.world())) << words[what];
  }
}

TEST_F(Servers, ThatAreKilledHalfWayLeaveTheWorldAndTheCacheAsTheyWere) {
  relay_->cut("GetCoverage", 2000, false, [this] { ::kill(-server_, SIGKILL); });
  const Imported w = import(plan(true, true, true, true, "killed"));
  ASSERT_FALSE(w.report);
  EXPECT_EQ(w.report.error().code, ErrorCode::unavailable) << w.complaint();
  EXPECT_EQ(w.world().node_count(), 0u);
  EXPECT_TRUE(cache_is_empty("killed"));
}

TEST_F(Servers, ComplainAboutALayerThatIsNotThere) {
  auto p = plan(false, false, true, true);
  p.sources[0].layer = "castles";
  EXPECT_NE(import(p).complaint().find("buildings"), std::string::npos) << import(p).complaint();
  p = plan(true, false, false, true);
  p.sources[0].layer = "dam";
  EXPECT_FALSE(import(p).report);
  p = plan(false, true, false, true);
  p.sources[0].layer = "painting";
  EXPECT_FALSE(import(p).report) << "an error in XML is no picture";
  EXPECT_TRUE(cache_is_empty("cache"));
}

TEST_F(Servers, ThatSayNothingTimeOut) {
  int port = 0;
  const int silent = listening(port);
  auto p = plan(true, false, false, true);
  p.sources[0].location = "WCS:http://127.0.0.1:" + std::to_string(port) + "/x?map=SITE";
  p.server_timeout_s = 1;
  const Imported w = import(p);  // without the timeout it would not return
  EXPECT_FALSE(w.report);
  ::close(silent);
}

}  // namespace
}  // namespace rigor::gis::test
