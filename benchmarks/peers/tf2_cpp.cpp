// tf2's C++ core, called from C++: a peer of the benchmark, speaking the protocol of worker.py.
//
//     g++ -O2 -o tf2_cpp tf2_cpp.cpp -ltf2 -lrostime -lconsole_bridge
//
// A line in is a measure and its argument, such as "lookup 3"; a line out is nanoseconds per
// operation, or bytes per sample. The chains, stamps and poses are those of data.py.

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <vector>

#include <geometry_msgs/TransformStamped.h>
#include <tf2/buffer_core.h>
#include <unistd.h>

namespace {

using geometry_msgs::TransformStamped;

// data.py, in C++.

constexpr int64_t kStartNs = 1'700'000'000'000'000'000;
constexpr int64_t kPeriodNs = 10'000'000;
constexpr int kSamples = 1000;
constexpr int64_t kInsertsAtOnce = 5'000;

std::string frame(int64_t i) { return "frame_" + std::to_string(i); }

ros::Time stamp(int64_t ns) {
  return ros::Time(static_cast<uint32_t>(ns / 1'000'000'000), static_cast<uint32_t>(ns % 1'000'000'000));
}

int64_t stamp_ns(int64_t sample) { return kStartNs + sample * kPeriodNs; }

// The i-th of many stamps that lie anywhere in a span.
int64_t scattered(int64_t start_ns, int64_t span_ns, int64_t i) {
  return start_ns + i * 7'919'000'017 % span_ns;
}

TransformStamped sample(int64_t parent, int64_t child, int64_t k) {
  TransformStamped ts;
  ts.header.stamp = stamp(stamp_ns(k));
  ts.header.frame_id = frame(parent);
  ts.child_frame_id = frame(child);
  double phase = 0.05 * k + child, half = 0.25 * std::sin(phase), s = std::sin(half);
  ts.transform.translation.x = std::cos(phase);
  ts.transform.translation.y = std::sin(phase);
  ts.transform.translation.z = 0.1;
  ts.transform.rotation.x = child % 3 == 0 ? s : 0.0;
  ts.transform.rotation.y = child % 3 == 1 ? s : 0.0;
  ts.transform.rotation.z = child % 3 == 2 ? s : 0.0;
  ts.transform.rotation.w = std::cos(half);
  return ts;
}

// A number of operations, to be timed; what they need is made before.
using Operations = std::function<void()>;
using Loop = std::function<Operations(int64_t count)>;

using Core = std::shared_ptr<tf2::BufferCore>;

Core chain(int64_t edges, int64_t samples, double cache_s = 10.0) {
  auto core = std::make_shared<tf2::BufferCore>(ros::Duration(cache_s));
  for (int64_t k = 0; k < samples; ++k)
    for (int64_t i = 0; i < edges; ++i) core->setTransform(sample(i, i + 1, k), "bench");
  return core;
}

double sink = 0.0;

Loop lookups(Core core, int64_t source, int64_t start_ns, int64_t span_ns) {
  return [=](int64_t count) {
    std::vector<ros::Time> times;
    for (int64_t i = 0; i < count; ++i) times.push_back(stamp(scattered(start_ns, span_ns, i)));
    std::string from = frame(0), to = frame(source);
    return [=] {
      for (const auto& time : times) sink += core->lookupTransform(from, to, time).transform.translation.x;
    };
  };
}

Loop lookup_back(int64_t edges, int64_t periods) {
  return lookups(chain(edges, kSamples), edges, stamp_ns(kSamples - 1 - periods), periods * kPeriodNs);
}

Loop lookup(int64_t edges) { return lookup_back(edges, 10); }

Loop lookup_anywhere(int64_t edges) { return lookup_back(edges, kSamples - 1); }

Loop latest(int64_t edges) {
  auto core = chain(edges, kSamples);
  return [=](int64_t count) {
    std::string from = frame(0), to = frame(edges);
    return [=] {
      for (int64_t i = 0; i < count; ++i)
        sink += core->lookupTransform(from, to, ros::Time()).transform.translation.x;
    };
  };
}

// `edges` transforms of each further stamp, one after the other.
Loop insert(int64_t edges) {
  auto core = chain(edges, kSamples);
  auto next = std::make_shared<int64_t>(kSamples);
  return [=](int64_t count) {
    std::vector<TransformStamped> transforms;
    for (int64_t i = 0; i < count; ++i) {
      transforms.push_back(sample(i % edges, i % edges + 1, *next));
      if (i % edges == edges - 1) ++*next;
    }
    return [=] {
      for (const auto& ts : transforms) core->setTransform(ts, "bench");
    };
  };
}

Loop deep(int64_t edges) {
  return lookups(chain(edges, 100), edges, stamp_ns(0), 99 * kPeriodNs);
}

Loop samples(int64_t count) {
  return lookups(chain(1, count, 1e6), 1, stamp_ns(0), (count - 1) * kPeriodNs);
}

// A tree where each frame has ten children, asked about any two frames.
Loop frames(int64_t count) {
  auto core = std::make_shared<tf2::BufferCore>(ros::Duration(10.0));
  for (int64_t k = 0; k < 2; ++k)
    for (int64_t i = 1; i < count; ++i) core->setTransform(sample((i - 1) / 10, i, k), "bench");
  return [=](int64_t lookups) {
    std::vector<std::pair<std::string, std::string>> pairs;
    for (int64_t i = 0; i < lookups; ++i)
      pairs.emplace_back(frame(scattered(0, count, 2 * i)), frame(scattered(0, count, 2 * i + 1)));
    auto time = stamp(kStartNs + kPeriodNs / 2);
    return [=] {
      for (const auto& [target, source] : pairs)
        sink += core->lookupTransform(target, source, time).transform.translation.x;
    };
  };
}

int64_t resident_bytes() {
  int64_t size, resident;
  std::ifstream("/proc/self/statm") >> size >> resident;
  return resident * sysconf(_SC_PAGESIZE);
}

double memory(int64_t samples) {
  int64_t before = resident_bytes();
  auto core = chain(100, samples / 100, 1e6);
  return static_cast<double>(resident_bytes() - before) / samples;
}

int64_t now_ns() {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

// Makes at most at_once operations at a time.
int64_t elapsed_ns(const Loop& loop, int64_t count, int64_t at_once) {
  int64_t elapsed = 0;
  for (int64_t done = 0; done < count; done += std::min(at_once, count - done)) {
    auto operations = loop(std::min(at_once, count - done));
    int64_t start = now_ns();
    operations();
    elapsed += now_ns() - start;
  }
  return elapsed;
}

// As worker.py chooses it: enough operations to fill the time.
int64_t enough(const Loop& loop, int64_t fill_ns, int64_t at_once) {
  int64_t count = 100;
  while (elapsed_ns(loop, count, at_once) < fill_ns) count *= 2;
  return count;
}

}  // namespace

int main() {
  const std::map<std::string, std::function<Loop(int64_t)>> measures = {
      {"lookup", lookup}, {"lookup_anywhere", lookup_anywhere}, {"latest", latest},
      {"insert", insert}, {"insert_columns", insert},
      {"deep", deep},     {"samples", samples},                 {"frames", frames},
  };
  std::map<std::string, std::pair<Loop, int64_t>> warm;
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream request(line);
    std::string name;
    int64_t argument = 0;
    request >> name >> argument;
    if (name == "version") {
      std::cout << "libtf2 of ROS Noetic, g++ " << __VERSION__ << std::endl;
    } else if (name == "memory") {
      std::cout << memory(argument) << std::endl;
    } else if (name == "forget") {
      warm.clear();
      std::cout << 0 << std::endl;
    } else if (name == "repeat") {  // as worker.py has it
      int64_t count = 0, of = 0;
      std::istringstream rest(line);
      rest >> name >> name >> argument >> count >> of;
      Loop loop = measures.at(name)(argument);
      loop(of - count);
      loop(count)();
      std::cout << 0 << std::endl;
    } else if (measures.count(name)) {
      int64_t at_once = name.rfind("insert", 0) == 0 ? kInsertsAtOnce : INT64_MAX;
      if (!warm.count(line)) {
        Loop loop = measures.at(name)(argument);
        warm[line] = {loop, enough(loop, 50'000'000, at_once)};
      }
      auto [loop, count] = warm[line];
      std::cout << static_cast<double>(elapsed_ns(loop, count, at_once)) / count << std::endl;
    } else {
      std::cout << "unavailable: not measured" << std::endl;
    }
  }
  return sink == 0.123;
}
