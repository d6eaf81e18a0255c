#include "drivers/gnss/epoch_assembler.h"

#include <algorithm>
#include <cmath>

#include "drivers/gnss/nmea.h"

namespace rigor::gnss {
namespace {

constexpr std::uint8_t kDateAndTime = 3;

/// The kind of a sentence by its formatter; of a UBX message by its id. Never 0.
constexpr std::uint32_t kind_of(std::string_view formatter) {
  return 0x1000000U | static_cast<std::uint32_t>(static_cast<unsigned char>(formatter[0])) << 16 |
         static_cast<std::uint32_t>(static_cast<unsigned char>(formatter[1])) << 8 |
         static_cast<std::uint32_t>(static_cast<unsigned char>(formatter[2]));
}
constexpr std::uint32_t kind_of(UbxId id) { return static_cast<std::uint32_t>(id); }

void set_horizontal_vertical(std::array<double, 9>& c, double horizontal_m2, double vertical_m2) {
  c.fill(0);
  c[0] = c[4] = horizontal_m2 / 2;
  c[8] = vertical_m2;
}

void put_pvt(Solution& s, const NavPvt& v, bool& accuracy) {
  using Mode = Solution::Mode;
  constexpr Mode kModes[] = {Mode::none,   Mode::dead_reckoning, Mode::fix_2d,
                             Mode::fix_3d, Mode::fix_3d,         Mode::time_only};
  s.mode = v.fix_type < std::size(kModes) ? kModes[v.fix_type] : Mode::none;
  const bool placed = s.mode != Mode::none && s.mode != Mode::time_only && (v.flags3 & 1) == 0;
  s.corrected = (v.flags & 2) != 0;
  const unsigned carrier = v.flags >> 6;
  s.status = !placed || (v.flags & 1) == 0 ? FixStatus::none
             : carrier == 2                ? FixStatus::rtk_fixed
             : carrier == 1                ? FixStatus::rtk_float
             : s.corrected                 ? FixStatus::sbas
                                           : FixStatus::fix;
  s.latitude_deg = v.latitude_e7 * 1e-7;
  s.longitude_deg = v.longitude_e7 * 1e-7;
  s.height_m = v.height_mm * 1e-3;
  s.height_msl_m = v.height_msl_mm * 1e-3;
  s.velocity_enu_mps = {v.east_mmps * 1e-3, v.north_mmps * 1e-3, v.down_mmps * -1e-3};
  s.speed_mps = v.ground_speed_mmps * 1e-3;
  s.course_deg = v.heading_e5 * 1e-5;
  s.velocity_sigma_mps = v.speed_accuracy_mmps * 1e-3;
  s.pdop = v.pdop_e2 * 1e-2;
  s.satellites_used = v.satellites;
  s.time_sigma = nanoseconds(v.time_accuracy_ns);
  accuracy = placed;
}

}  // namespace

EpochAssembler::EpochAssembler(const Options& options, Handler handler)
    : options_(options), handler_(std::move(handler)) {
  sky_.satellites.reserve(256);
  used_.reserve(256);
  now_.seen.reserve(32);
}

void EpochAssembler::reset() {
  now_.any = false;
  end_ = 0;
  ubx_speaks_ = false;
  week_.reset(), day_.reset();
  leaps_ns_ = 0;
  in_leap_second_ = false;
  utc_minus_day_ns_.reset();
  used_.clear();
  sky_open_ = false;
  sky_.satellites.clear();
}

void EpochAssembler::take(const Message& m, BenchTime arrival) {
  if (m.kind == Message::Kind::ubx)
    take_ubx(m, arrival);
  else if (m.kind == Message::Kind::nmea)
    take_nmea(m, arrival);
}

void EpochAssembler::hand_over() {
  if (!now_.any || now_.handed) return;
  now_.handed = true;
  Solution& s = now_.s;
  // Sentences hold twelve satellites each, and some receivers count no more.
  if (!now_.ubx && used_of_this_ && s.has_fix())
    s.satellites_used = std::max<std::uint16_t>(s.satellites_used, static_cast<std::uint16_t>(used_.size()));
  if (!now_.has_covariance && !now_.has_accuracy && std::isfinite(s.hdop)) {
    const double r2 = options_.range_error_m * options_.range_error_m;
    set_horizontal_vertical(s.covariance_enu_m2, 2 * r2 * s.hdop * s.hdop, r2 * s.vdop * s.vdop);
  }
  s.covariance_told = now_.has_covariance || now_.has_accuracy;
  ++counters_.solutions;
  if (handler_.solution) handler_.solution(s, now_.arrival);
}

Solution* EpochAssembler::open(bool ubx, std::int64_t key, BenchTime arrival) {
  if (now_.any && now_.ubx == ubx && now_.key == key) return &now_.s;
  if (now_.any) {
    end_ = now_.last;
    hand_over();
  }
  auto seen = std::move(now_.seen);
  seen.clear();
  now_ = Pending{};
  now_.seen = std::move(seen);
  now_.any = true;
  now_.ubx = ubx;
  now_.key = key;
  now_.arrival = arrival;
  used_of_this_ = false;
  return &now_.s;
}

void EpochAssembler::close(std::uint32_t kind) {
  if (!now_.any) return;
  auto it = std::find_if(now_.seen.begin(), now_.seen.end(), [&](const auto& k) { return k.first == kind; });
  if (it == now_.seen.end()) it = now_.seen.insert(it, {kind, 0});
  ++it->second;
  now_.last = Tag{kind} << 32 | it->second;
  if (now_.handed)
    ++counters_.after_the_end;
  else if (now_.last == end_)
    hand_over();
}

void EpochAssembler::flush() {
  finish_sky();
  if (now_.any && !now_.handed) {
    end_ = now_.last;
    hand_over();
  }
}

void EpochAssembler::take_ubx(const Message& m, BenchTime arrival) {
  finish_sky();
  const Bytes p = m.payload;
  const auto begin = [&](std::uint32_t itow_ms) -> Solution* {
    if (itow_ms >= kWeek_ns / 1'000'000) return nullptr;
    Solution* s = open(true, itow_ms, arrival);
    s->t_device = DeviceTime(week_.next(std::int64_t{itow_ms} * 1'000'000));
    return s;
  };
  bool good = true;
  switch (m.ubx) {
    case UbxId::nav_pvt: {
      const auto v = parse_nav_pvt(p);
      ubx_speaks_ |= v.has_value();
      sentences_since_pvt_ = 0;
      Solution* s = v ? begin(v->itow_ms) : nullptr;
      if (!(good = s)) break;
      const Solution fine = *s;  // NAV-HPPOSLLH may have come before
      bool accuracy = false;
      put_pvt(*s, *v, accuracy);
      if ((v->valid & kDateAndTime) == kDateAndTime && is_date(v->year, v->month, v->day) && v->hour < 24 &&
          v->minute < 60 && v->second <= 60)
        s->utc = realtime_of({v->year, v->month, v->day, v->hour, v->minute, v->second, v->nano});
      if (now_.has_fine_place) {
        s->latitude_deg = fine.latitude_deg, s->longitude_deg = fine.longitude_deg;
        s->height_m = fine.height_m, s->height_msl_m = fine.height_msl_m;
      } else if (accuracy && !now_.has_covariance) {
        const double h = v->horizontal_accuracy_mm * 1e-3, u = v->vertical_accuracy_mm * 1e-3;
        set_horizontal_vertical(s->covariance_enu_m2, h * h, u * u);
        now_.has_accuracy = true;
      }
      break;
    }
    case UbxId::nav_dop: {
      const auto d = parse_nav_dop(p);
      Solution* s = d ? begin(d->itow_ms) : nullptr;
      if (!(good = s)) break;
      s->hdop = d->horizontal_e2 * 1e-2, s->vdop = d->vertical_e2 * 1e-2, s->pdop = d->position_e2 * 1e-2;
      break;
    }
    case UbxId::nav_cov: {
      const auto c = parse_nav_cov(p);
      Solution* s = c ? begin(c->itow_ms) : nullptr;
      if (!(good = s)) break;
      if (!c->position_valid) break;
      // NN, NE, ND, EE, ED, DD to east, north, up.
      const auto& n = c->position_m2;
      const double nn = n[0], ne = n[1], nd = n[2], ee = n[3], ed = n[4], dd = n[5];
      s->covariance_enu_m2 = {ee, ne, -ed, ne, nn, -nd, -ed, -nd, dd};
      now_.has_covariance = true;
      break;
    }
    case UbxId::nav_hpposllh: {
      const auto h = parse_nav_hpposllh(p);
      Solution* s = h ? begin(h->itow_ms) : nullptr;
      if (!(good = s)) break;
      if (h->invalid) break;
      s->latitude_deg = h->latitude_e7 * 1e-7 + h->latitude_e9 * 1e-9;
      s->longitude_deg = h->longitude_e7 * 1e-7 + h->longitude_e9 * 1e-9;
      s->height_m = h->height_mm * 1e-3 + h->height_e4 * 1e-4;
      s->height_msl_m = h->height_msl_mm * 1e-3 + h->height_msl_e4 * 1e-4;
      if (!now_.has_covariance) {
        const double a = h->horizontal_accuracy_e4 * 1e-4, u = h->vertical_accuracy_e4 * 1e-4;
        set_horizontal_vertical(s->covariance_enu_m2, a * a, u * u);
        now_.has_accuracy = true;
      }
      now_.has_fine_place = true;
      break;
    }
    case UbxId::nav_eoe: {
      const auto itow = parse_nav_eoe(p);
      if (!(good = itow && begin(*itow))) break;
      break;
    }
    case UbxId::nav_timegps:
      if (const auto t = parse_nav_timegps(p); t && (t->valid & 4) != 0) leap_seconds_ = t->leap_seconds;
      return;
    case UbxId::nav_sat:
      if (!parse_nav_sat(p, sat_)) {
        ++counters_.malformed;
        return;
      }
      sky_.t_device.reset();
      if (week_.any() && sat_.itow_ms < kWeek_ns / 1'000'000)
        sky_.t_device = DeviceTime(week_.nearest(std::int64_t{sat_.itow_ms} * 1'000'000));
      sky_.satellites.clear();
      for (std::size_t i = 0; i < sat_.count; ++i) {
        const NavSatEntry& e = sat_.satellite[i];
        Satellite v;
        v.id = {static_cast<Gnss>(e.gnss), e.satellite};
        if (e.gnss > static_cast<std::uint8_t>(Gnss::glonass)) continue;
        // Directions that are not known are told as −91° of elevation.
        if (e.elevation_deg >= -90 && e.elevation_deg <= 90) v.elevation_deg = e.elevation_deg;
        if (e.azimuth_deg >= 0 && e.azimuth_deg <= 360) v.azimuth_deg = e.azimuth_deg;
        v.cn0_dbhz = e.cn0_dbhz;
        v.used = (e.flags & 8) != 0;
        sky_.satellites.push_back(v);
      }
      ++counters_.skies;
      if (handler_.sky) handler_.sky(sky_);
      return;
    case UbxId::tim_tp: {
      const auto t = parse_tim_tp(p);
      if (!t || t->tow_ms >= kWeek_ns / 1'000'000) {
        ++counters_.malformed;
        return;
      }
      // Before the first solution the week is not known.
      if (!week_.any()) return;
      TimePulse pulse;
      pulse.utc_base = (t->flags & 1) != 0;
      std::int64_t tow_ns = std::int64_t{t->tow_ms} * 1'000'000 +
                            static_cast<std::int64_t>(std::llround(t->tow_sub_ms_e32 * 0x1p-32 * 1e6));
      if (pulse.utc_base) tow_ns += leap_seconds_.value_or(0) * std::int64_t{1'000'000'000};
      pulse.t_device = DeviceTime(week_.nearest(tow_ns % kWeek_ns));
      pulse.quantization_ns = (t->flags & 16) != 0 ? Solution::kNone : t->quantization_ps * 1e-3;
      ++counters_.pulses;
      if (handler_.pulse) handler_.pulse(pulse);
      return;
    }
    case UbxId::rxm_rawx:
      if (const auto head = parse_rawx(p)) {
        if (head->leap_seconds > 0) leap_seconds_ = head->leap_seconds;
        ++counters_.raw_measurements;
        if (handler_.raw) handler_.raw(p);
      } else {
        ++counters_.malformed;
      }
      return;
    default:
      return;
  }
  if (good)
    close(kind_of(m.ubx));
  else
    ++counters_.malformed;
}

bool EpochAssembler::open_day(const TimeOfDay& t, BenchTime arrival) {
  const bool another = !now_.any || now_.ubx || now_.key != t.ns;
  Solution* s = open(false, t.ns, arrival);
  if (!another) return true;
  // After a leap second the day's count begins a second later than it would.
  if (in_leap_second_ && !t.leap_second) leaps_ns_ += 1'000'000'000;
  in_leap_second_ = t.leap_second;
  const std::int64_t day_ns = day_.next(t.ns % kDay_ns);
  s->t_device = DeviceTime(day_ns + leaps_ns_);
  if (utc_minus_day_ns_) s->utc = RealtimeTime(day_ns + *utc_minus_day_ns_);
  return true;
}

void EpochAssembler::set_date(const Date& date) {
  if (!now_.any || now_.ubx) return;
  // The date is of the day in which the time of day lies; 23:59:60 lies in the old one.
  const std::int64_t utc_ns = days_from_date(date.year, date.month, date.day) * kDay_ns + now_.key;
  const std::int64_t day_ns = now_.s.t_device.ns() - leaps_ns_;
  utc_minus_day_ns_ = utc_ns - day_ns;
  now_.s.utc = RealtimeTime(utc_ns);
}

void EpochAssembler::take_nmea(const Message& m, BenchTime arrival) {
  const auto s = split_sentence(m.text);
  if (!s) return;
  if (s->formatter == "GSV") {
    if (ubx_speaks_) return;  // NAV-SAT says it
    if (!take_gsv(*s)) ++counters_.malformed;
    return;
  }
  finish_sky();
  if (ubx_speaks_) {
    // NAV-PVT may have been switched off.
    if (s->formatter == "RMC" || s->formatter == "GGA") ubx_speaks_ = ++sentences_since_pvt_ < 20;
    if (ubx_speaks_) return;
  }
  if (!take_sentence(*s, arrival)) ++counters_.malformed;
}

bool EpochAssembler::take_sentence(const Sentence& s, BenchTime arrival) {
  Solution& now = now_.s;
  if (s.formatter == "RMC") {
    const auto m = parse_rmc(s);
    if (!m) return false;
    if (!m->time) return true;  // before the receiver knows the time
    open_day(*m->time, arrival);
    if (now_.handed) return close(kind_of(s.formatter)), true;
    if (m->date) set_date(*m->date);
    if (!m->valid || m->mode == 'N') {
      now.status = FixStatus::none;
      now.mode = Solution::Mode::none;
    } else {
      now.latitude_deg = m->place.latitude_deg, now.longitude_deg = m->place.longitude_deg;
      now.speed_mps = m->speed_mps, now.course_deg = m->course_deg;
      now.corrected |= m->mode == 'D' || m->mode == 'R' || m->mode == 'F';
      if (now.mode == Solution::Mode::none) now.mode = Solution::Mode::fix_2d;
      if (m->mode == 'R')
        now.status = FixStatus::rtk_fixed;
      else if (m->mode == 'F')
        now.status = FixStatus::rtk_float;
      else if (now.status == FixStatus::none)
        now.status = m->mode == 'D' ? FixStatus::sbas : FixStatus::fix;
    }
  } else if (s.formatter == "GGA") {
    const auto g = parse_gga(s);
    if (!g) return false;
    if (!g->time) return true;
    open_day(*g->time, arrival);
    if (now_.handed) return close(kind_of(s.formatter)), true;
    now.satellites_used = static_cast<std::uint16_t>(g->satellites);
    now.hdop = g->hdop;
    now.correction_age_s = g->correction_age_s;
    if (g->quality == 0) {
      now.status = FixStatus::none;
      now.mode = Solution::Mode::none;
    } else {
      now.latitude_deg = g->place.latitude_deg, now.longitude_deg = g->place.longitude_deg;
      now.height_msl_m = g->height_msl_m;
      now.height_m = g->height_msl_m + g->geoid_separation_m;
      now.corrected |= g->quality == 2 || g->quality == 4 || g->quality == 5;
      now.status = g->quality == 4   ? FixStatus::rtk_fixed
                   : g->quality == 5 ? FixStatus::rtk_float
                   : g->quality == 2 ? FixStatus::sbas
                                     : FixStatus::fix;
      now.mode = g->quality == 6                  ? Solution::Mode::dead_reckoning
                 : std::isfinite(g->height_msl_m) ? Solution::Mode::fix_3d
                                                  : Solution::Mode::fix_2d;
    }
  } else if (s.formatter == "GLL") {
    const auto g = parse_gll(s);
    if (!g) return false;
    if (!g->time) return true;
    open_day(*g->time, arrival);
    if (!now_.handed && g->valid && !std::isfinite(now.latitude_deg)) {
      now.latitude_deg = g->place.latitude_deg, now.longitude_deg = g->place.longitude_deg;
      if (now.status == FixStatus::none) now.status = FixStatus::fix, now.mode = Solution::Mode::fix_2d;
    }
  } else if (s.formatter == "GST") {
    const auto g = parse_gst(s);
    if (!g) return false;
    if (!g->time) return true;
    open_day(*g->time, arrival);
    if (!now_.handed && std::isfinite(g->sigma_latitude_m) && std::isfinite(g->sigma_longitude_m)) {
      const double n = g->sigma_latitude_m, e = g->sigma_longitude_m, u = g->sigma_height_m;
      now.covariance_enu_m2 = {e * e, 0, 0, 0, n * n, 0, 0, 0, u * u};
      now_.has_covariance = true;
    }
  } else if (s.formatter == "ZDA") {
    const auto z = parse_zda(s);
    if (!z) return false;
    if (!z->time) return true;
    open_day(*z->time, arrival);
    if (!now_.handed && z->date) set_date(*z->date);
  } else if (s.formatter == "VTG") {
    const auto v = parse_vtg(s);
    if (!v) return false;
    if (now_.any && !now_.handed && std::isfinite(v->speed_mps)) {
      now.speed_mps = v->speed_mps;
      now.course_deg = v->course_deg;
    }
  } else if (s.formatter == "GSA") {
    if (!take_gsa(s)) return false;
  } else {
    return true;
  }
  if (!now_.handed && std::isfinite(now.speed_mps) && std::isfinite(now.course_deg)) {
    now.velocity_enu_mps[0] = now.speed_mps * std::sin(now.course_deg * kRadPerDeg);
    now.velocity_enu_mps[1] = now.speed_mps * std::cos(now.course_deg * kRadPerDeg);
  }
  close(kind_of(s.formatter));
  return true;
}

bool EpochAssembler::take_gsa(const Sentence& s) {
  const auto g = parse_gsa(s);
  if (!g) return false;
  if (!used_of_this_) used_.clear();
  used_of_this_ = true;
  for (std::size_t i = 0; i < g->count; ++i)
    if (used_.size() < used_.capacity() && std::find(used_.begin(), used_.end(), g->used[i]) == used_.end())
      used_.push_back(g->used[i]);
  if (!now_.any || now_.handed) return true;
  Solution& now = now_.s;
  if (std::isfinite(g->pdop)) now.pdop = g->pdop;
  if (std::isfinite(g->hdop)) now.hdop = g->hdop;
  if (std::isfinite(g->vdop)) now.vdop = g->vdop;
  // Of several constellations each has its sentence, and says the mode of the whole.
  if (now.has_fix() && now.mode != Solution::Mode::dead_reckoning && g->mode > 1)
    now.mode = g->mode == 3 ? Solution::Mode::fix_3d : Solution::Mode::fix_2d;
  return true;
}

bool EpochAssembler::take_gsv(const Sentence& s) {
  const auto g = parse_gsv(s);
  if (!g) return false;
  if (!sky_open_) {
    sky_open_ = true;
    sky_.satellites.clear();
    sky_.t_device.reset();
    if (now_.any && !now_.ubx) sky_.t_device = now_.s.t_device;
    sky_next_ = 1;
    sky_group_ = 0;
  }
  // A group of sentences is one constellation and signal; one that lacks a sentence is left out.
  if (g->number == 1) {
    drop_open_group();
    sky_total_ = g->total;
  }
  if (g->number != sky_next_ || g->total != sky_total_) {
    if (sky_next_ > 1) drop_open_group();
    sky_next_ = 1;
    return true;
  }
  for (std::size_t i = 0; i < g->count; ++i)
    if (sky_.satellites.size() < sky_.satellites.capacity()) sky_.satellites.push_back(g->satellite[i]);
  sky_next_ = g->number + 1;
  if (g->number == g->total) {
    sky_next_ = 1;
    sky_group_ = sky_.satellites.size();
  }
  return true;
}

void EpochAssembler::drop_open_group() {
  if (sky_next_ == 1) return;
  ++counters_.incomplete_groups;
  sky_.satellites.resize(sky_group_);
  sky_next_ = 1;
}

void EpochAssembler::finish_sky() {
  if (!sky_open_) return;
  sky_open_ = false;
  drop_open_group();
  if (sky_.satellites.empty()) return;
  for (Satellite& v : sky_.satellites) v.used = std::find(used_.begin(), used_.end(), v.id) != used_.end();
  ++counters_.skies;
  if (handler_.sky) handler_.sky(sky_);
}

}  // namespace rigor::gnss
