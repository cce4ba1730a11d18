// A planner without dependencies: shortest paths among rock, robot by robot; others and currents are
// not looked at. Reads what `angler problems SCENARIO --raw` writes, writes what `angler rollout
// --plans` flies. Build and run (C++17, a little-endian machine):
//
//     c++ -O2 -std=c++17 -o shortest shortest.cpp && ./shortest problems.zarr plans.zarr

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <iterator>
#include <limits>
#include <queue>
#include <string>
#include <vector>

namespace fs = std::filesystem;
using Point = std::array<float, 3>;

std::string text(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  if (!in) { std::cerr << file << ": cannot be read\n"; std::exit(1); }
  return {std::istreambuf_iterator<char>(in), {}};
}

// The text behind a key of a JSON file whose keys are all different.
std::string behind(const std::string& json, const std::string& key) {
  const auto at = json.find('"' + key + '"');
  if (at == std::string::npos) { std::cerr << "no " << key << "\n"; std::exit(1); }
  return json.substr(json.find(':', at) + 1);
}
double number(const std::string& json, const std::string& key) { return std::stod(behind(json, key)); }
std::string word(const std::string& json, const std::string& key) {
  const auto rest = behind(json, key);
  const auto first = rest.find('"') + 1;
  return rest.substr(first, rest.find('"', first) - first);
}
std::vector<int> shape(const fs::path& array) {
  auto rest = behind(text(array / "zarr.json"), "shape");
  rest = rest.substr(rest.find('[') + 1, rest.find(']') - rest.find('[') - 1);
  std::replace(rest.begin(), rest.end(), ',', ' ');
  std::vector<int> sizes;
  for (char* next = rest.data();;) {
    char* end;
    const long size = std::strtol(next, &end, 10);
    if (end == next) return sizes;
    sizes.push_back(int(size));
    next = end;
  }
}

// The numbers of one world: one file, in C order.
template <class T> std::vector<T> read(const fs::path& array, int world) {
  auto file = array / "c" / std::to_string(world);
  for (std::size_t axis = 1; axis < shape(array).size(); ++axis) file /= "0";
  const auto bytes = text(file);
  std::vector<T> numbers(bytes.size() / sizeof(T));
  std::copy(bytes.begin(), bytes.end(), reinterpret_cast<char*>(numbers.data()));
  return numbers;
}

struct Rock {
  std::vector<uint8_t> occupied;
  std::array<int, 3> n;
  Point origin;
  float cell, floor;

  int index(int i, int j, int k) const { return (i * n[1] + j) * n[2] + k; }
  Point centre(int at) const {
    const int ijk[3] = {at / (n[1] * n[2]), at / n[2] % n[1], at % n[2]};
    Point p;
    for (int a = 0; a < 3; ++a) p[a] = origin[a] + cell * (ijk[a] + 0.5f);
    return p;
  }
  // Whether a ball meets neither rock nor floor nor a face of the cube.
  bool clear(const Point& p, float radius) const {
    int low[3], high[3];
    for (int a = 0; a < 3; ++a) {
      if (p[a] - radius < origin[a] || p[a] + radius > origin[a] + cell * n[a]) return false;
      low[a] = std::max(0, int((p[a] - radius - origin[a]) / cell));
      high[a] = std::min(n[a] - 1, int((p[a] + radius - origin[a]) / cell));
    }
    if (p[2] - radius < floor) return false;
    for (int i = low[0]; i <= high[0]; ++i)
      for (int j = low[1]; j <= high[1]; ++j)
        for (int k = low[2]; k <= high[2]; ++k) {
          if (!occupied[index(i, j, k)]) continue;
          const Point c = centre(index(i, j, k));
          float square = 0;
          for (int a = 0; a < 3; ++a) square += std::pow(std::max(0.f, std::abs(p[a] - c[a]) - cell / 2), 2);
          if (square < radius * radius) return false;
        }
    return true;
  }
  bool clear(const Point& a, const Point& b, float radius) const {
    const float length = std::hypot(b[0] - a[0], b[1] - a[1], b[2] - a[2]);
    const int steps = std::max(1, int(std::ceil(length / (0.25f * cell))));
    for (int s = 0; s <= steps; ++s) {
      Point p;
      for (int x = 0; x < 3; ++x) p[x] = a[x] + (b[x] - a[x]) * s / steps;
      if (!clear(p, radius)) return false;
    }
    return true;
  }
};

// Dijkstra's search over the centres of cells, then straightened; empty where there is no path.
std::vector<Point> path(const Rock& rock, const Point& start, const Point& goal, float radius) {
  if (rock.clear(start, goal, radius)) return {start, goal};
  const int total = int(rock.occupied.size());
  std::vector<float> cost(total, std::numeric_limits<float>::infinity());
  std::vector<int> before(total, -1);
  std::vector<char> free(total);
  using Entry = std::pair<float, int>;
  std::priority_queue<Entry, std::vector<Entry>, std::greater<Entry>> open;
  const auto apart = [](const Point& a, const Point& b) { return std::hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]); };
  for (int at = 0; at < total; ++at) {
    const Point p = rock.centre(at);
    free[at] = rock.clear(p, radius);
    if (free[at] && apart(p, start) < 2 * rock.cell && rock.clear(start, p, radius)) open.push({cost[at] = apart(p, start), at});
  }
  int last = -1;
  while (!open.empty() && last < 0) {
    const auto [spent, at] = open.top();
    open.pop();
    if (spent > cost[at]) continue;
    const Point p = rock.centre(at);
    if (apart(p, goal) < 2 * rock.cell && rock.clear(p, goal, radius)) last = at;
    const int i = at / (rock.n[1] * rock.n[2]), j = at / rock.n[2] % rock.n[1], k = at % rock.n[2];
    for (int x = std::max(0, i - 1); x <= std::min(rock.n[0] - 1, i + 1); ++x)
      for (int y = std::max(0, j - 1); y <= std::min(rock.n[1] - 1, j + 1); ++y)
        for (int z = std::max(0, k - 1); z <= std::min(rock.n[2] - 1, k + 1); ++z) {
          const int next = rock.index(x, y, z);
          const float there = spent + apart(p, rock.centre(next));
          if (!free[next] || there >= cost[next] || !rock.clear(p, rock.centre(next), radius)) continue;
          cost[next] = there, before[next] = at;
          open.push({there, next});
        }
  }
  if (last < 0) return {};
  std::vector<Point> whole{goal};
  for (int at = last; at >= 0; at = before[at]) whole.push_back(rock.centre(at));
  whole.push_back(start);
  std::reverse(whole.begin(), whole.end());
  std::vector<Point> straight{start};
  for (std::size_t at = 0; at + 1 < whole.size();) {
    std::size_t far = whole.size() - 1;
    while (far > at + 1 && !rock.clear(whole[at], whole[far], radius)) --far;
    straight.push_back(whole[at = far]);
  }
  return straight;
}

// An array of a Zarr group in one chunk.
template <class T> void write(const fs::path& array, const std::string& type, const std::vector<int>& sizes, const std::vector<T>& numbers) {
  std::string list;
  fs::path chunk = array / "c";
  for (const int size : sizes) list += (list.empty() ? "" : ", ") + std::to_string(size), chunk /= "0";
  fs::create_directories(chunk.parent_path());
  std::ofstream(array / "zarr.json") << R"({"zarr_format": 3, "node_type": "array", "shape": [)" << list << R"(], "data_type": ")" << type
      << R"(", "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [)" << list
      << R"(]}}, "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}}, "fill_value": 0, )"
      << R"("codecs": [{"name": "bytes", "configuration": {"endian": "little"}}], "attributes": {}})";
  std::ofstream(chunk, std::ios::binary).write(reinterpret_cast<const char*>(numbers.data()), std::streamsize(numbers.size() * sizeof(T)));
}

int main(int count, char** arguments) {
  if (count != 3) { std::cerr << "usage: shortest PROBLEMS PLANS\n"; return 1; }
  const fs::path problems = arguments[1], plans = arguments[2];
  const auto about = text(problems / "zarr.json");
  const auto sizes = shape(problems / "grid/occupied"), team = shape(problems / "team/start_m");
  const int worlds = team[0], robots = team[1], most = int(number(about, "max_points"));
  std::vector<int32_t> points(worlds * robots, 0);
  std::vector<float> times(worlds * robots * most, 0), places(worlds * robots * most * 3, 0), seconds(worlds, 0);
  for (int world = 0; world < worlds; ++world) {
    const auto begin = std::chrono::steady_clock::now();
    const auto one = [&](const char* name) { return read<float>(problems / name, world); };
    const auto origin = one("grid/origin_m"), start = one("team/start_m"), goal = one("team/goal_m");
    const auto radius = one("team/radius_m"), speed = one("team/cruise_speed_mps");
    const Rock rock{read<uint8_t>(problems / "grid/occupied", world), {sizes[1], sizes[2], sizes[3]},
                    {origin[0], origin[1], origin[2]}, one("grid/cell_m")[0], one("floor_z_m")[0]};
    for (int robot = 0; robot < robots; ++robot) {
      const auto of = [&](const std::vector<float>& rows) { return Point{rows[3 * robot], rows[3 * robot + 1], rows[3 * robot + 2]}; };
      const auto found = path(rock, of(start), of(goal), radius[robot] + float(number(about, "margin_m")));
      if (found.empty() || int(found.size()) > most) continue;
      const int at = world * robots + robot;
      float time = 0;
      for (std::size_t i = 0; i < found.size(); ++i) {
        if (i) time += std::hypot(found[i][0] - found[i - 1][0], found[i][1] - found[i - 1][1], found[i][2] - found[i - 1][2]) / speed[robot];
        times[at * most + i] = time;
        std::copy(found[i].begin(), found[i].end(), places.begin() + 3 * (at * most + i));
      }
      if (time <= number(about, "horizon_s")) points[at] = int(found.size());
    }
    seconds[world] = std::chrono::duration<float>(std::chrono::steady_clock::now() - begin).count();
  }
  write(plans / "points", "int32", {worlds, robots}, points);
  write(plans / "time_s", "float32", {worlds, robots, most}, times);
  write(plans / "position_m", "float32", {worlds, robots, most, 3}, places);
  write(plans / "planning_s", "float32", {worlds}, seconds);
  std::ofstream(plans / "zarr.json") << R"({"zarr_format": 3, "node_type": "group", "attributes": {"schema": "angler_mjx plans", "schema_version": 1, "digest": ")"
      << word(about, "digest") << R"(", "scenario": ")" << word(about, "scenario") << R"(", "seed": )" << int64_t(number(about, "seed")) << "}}";
  std::cout << std::count_if(points.begin(), points.end(), [](int n) { return n > 0; }) << " of " << points.size() << " robots have a path\n";
}
