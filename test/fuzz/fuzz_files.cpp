/// Changes valid files of every kind that the package reads, at random but for a seed, and gives them to their readers.
/// A reader must come back with what it read or with one error that names the file: no exception, no crash, no hang.
///
///     fuzz_files FILES_A_KIND [SEED [KIND]]
///
/// Prints a table. Files that did harm are kept in the working directory.
#include <fcntl.h>
#include <rosbag/bag.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/Image.h>
#include <tf2_msgs/TFMessage.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <functional>
#include <opencv2/imgcodecs.hpp>
#include <string>
#include <vector>

#include "pipeline/map_state.h"
#include "ros/conversions.h"
#include "ros/tum_bag.h"
#include "semantic_topo_loop/io/detection_file.h"
#include "semantic_topo_loop/io/map_file.h"
#include "semantic_topo_loop/io/rgbd_recording.h"
#include "semantic_topo_loop/io/run_files.h"
#include "semantic_topo_loop/io/run_recorder.h"
#include "semantic_topo_loop/io/tum_trajectory.h"
#include "semantic_topo_loop/pipeline/frame_builder.h"
#include "semantic_topo_loop/pipeline/object_slam.h"
#include "support/package_config.h"
#include "tools/evaluation/loop_evaluation.h"
#include "tools/evaluation/object_evaluation.h"
#include "tools/g2o/g2o.h"
#include "tools/simulation/random.h"
#include "tools/simulation/sequence.h"

namespace semantic_topo_loop::core {
namespace {

constexpr unsigned kHang_s = 60;
constexpr std::size_t kMaxSize = 1 << 18;

struct Kind {
  std::string name;
  std::string file;                                     ///< below the directory of the reader
  std::vector<std::string> seeds;                       ///< valid texts
  std::function<Status(const std::string& path)> read;  ///< of the changed file
};

/// What is being read, for the alarm.
std::string current;

void on_alarm(int) {
  // Only what is safe in a signal handler.
  const auto unused = ::write(STDERR_FILENO, current.c_str(), current.size());
  static_cast<void>(unused);
  ::_exit(3);
}

template <class Value>
Status status_of(const Result<Value>& result) {
  return result ? Status() : Status(result.error());
}

// --- changes ------------------------------------------------------------------------------------------------------

class Mutator {
 public:
  explicit Mutator(std::uint64_t seed) : random_(seed) {}

  std::string mutate(const std::vector<std::string>& seeds) {
    std::string text = seeds[index(seeds.size())];
    for (int changes = random_.integer(1, 4); changes > 0; --changes) change(seeds, &text);
    if (text.size() > kMaxSize) text.resize(kMaxSize);
    return text;
  }

 private:
  std::size_t index(std::size_t count) { return static_cast<std::size_t>(random_.index(static_cast<int>(count))); }
  std::size_t place(const std::string& text) { return index(text.size() + 1); }

  void change(const std::vector<std::string>& seeds, std::string* text) {
    switch (random_.index(10)) {
      case 0:  // bits
        if (!text->empty()) {
          char& byte = (*text)[index(text->size())];
          byte = static_cast<char>(byte ^ 1 << random_.index(8));
        }
        break;
      case 1:
        text->resize(place(*text));
        break;
      case 2:  // twice
        text->insert(place(*text), part(*text));
        break;
      case 3: {
        const std::size_t from = place(*text);
        text->erase(from, part(*text).size());
        break;
      }
      case 4:
        text->insert(place(*text), part(seeds[index(seeds.size())]));
        break;
      case 5:
        text->insert(place(*text), bytes());
        break;
      case 6:
        swap_lines(text);
        break;
      default:
        replace_number(text);
    }
  }

  /// From a few bytes to a few hundred.
  std::string part(const std::string& text) {
    return text.substr(place(text), static_cast<std::size_t>(random_.integer(1, random_.chance(0.5) ? 10 : 400)));
  }
  std::string bytes() {
    static const std::vector<std::string> kTexts = {
        "[",       "{",   "\"", "}",    ":",    ",",  "\n",   "\r\n",         " ", "\t",      "\0", "\xff", "#",
        "&a [*a]", "!!x", "- ", "null", "true", "''", "\\u0", "\xef\xbb\xbf", "%", "../../x", "*"};
    std::string text = kTexts[index(kTexts.size())];
    // Deep nesting, long lines.
    if (random_.chance(0.05)) {
      const std::string one = text;
      for (int i = 0; i < 20000; ++i) text += one;
    }
    return text;
  }
  void swap_lines(std::string* text) {
    const std::size_t a = text->find('\n', place(*text));
    if (a == std::string::npos) return;
    const std::size_t b = text->find('\n', a + 1), c = b == std::string::npos ? b : text->find('\n', b + 1);
    if (c == std::string::npos) return;
    std::rotate(text->begin() + static_cast<std::ptrdiff_t>(a), text->begin() + static_cast<std::ptrdiff_t>(b),
                text->begin() + static_cast<std::ptrdiff_t>(c));
  }
  void replace_number(std::string* text) {
    static const std::vector<std::string> kNumbers = {"nan",
                                                      "-nan",
                                                      "inf",
                                                      "-inf",
                                                      "1e999",
                                                      "-1e999",
                                                      "1e308",
                                                      "1e-320",
                                                      "-1",
                                                      "0",
                                                      "-0",
                                                      "4294967352",
                                                      "1e20",
                                                      "2147483648",
                                                      "-2147483649",
                                                      "9223372036854775807",
                                                      "-9223372036854775808",
                                                      "18446744073709551616",
                                                      "0x10",
                                                      "1,5",
                                                      "",
                                                      "1.0",
                                                      "1e-9",
                                                      "99999999999999999999999999"};
    constexpr const char* kDigits = "0123456789";
    const std::size_t from = text->find_first_of(kDigits, place(*text));
    if (from == std::string::npos) return;
    const std::size_t end = std::min(text->find_first_not_of("0123456789.eE+-", from), text->size());
    text->replace(from, end - from, kNumbers[index(kNumbers.size())]);
  }

  Random random_;
};

// --- valid files --------------------------------------------------------------------------------------------------

/// libpng and roscpp print about every file that is none.
class Silence {
 public:
  Silence() : stderr_(::dup(STDERR_FILENO)) {
    const int null = ::open("/dev/null", O_WRONLY);
    ::dup2(null, STDERR_FILENO);
    ::close(null);
  }
  ~Silence() {
    ::dup2(stderr_, STDERR_FILENO);
    ::close(stderr_);
  }

 private:
  int stderr_;
};

/// A short run with two laps, so that there are objects, loops and submaps.
SimulatedSequence make_sequence() {
  const OptionTexts options = {
      {"trajectory.duration_s", "40"}, {"trajectory.lap_s", "18"}, {"trajectory.rate_hz", "5"}};
  return checked(simulate(checked(make_options<SimulationOptions>(options)), camera_fr2(), coco()));
}

/// A bag in the official TUM layout, of three grey images with their depth.
void write_valid_bag(const std::string& path, rosbag::CompressionType compression) {
  rosbag::Bag bag(path, rosbag::bagmode::Write);
  bag.setCompression(compression);
  for (int i = 0; i < 3; ++i) {
    const ros::Time time(100.0 + 0.05 * i);
    tf2_msgs::TFMessage transforms;
    transforms.transforms.push_back(make_transform(make_header(time, "/world"), "/kinect", SE3()));
    bag.write("/tf", time, transforms);
    sensor_msgs::CameraInfo info;
    to_msg(small_camera(), &info);
    sensor_msgs::Image image;
    image.header = info.header = make_header(time, "/openni_rgb_optical_frame");
    image.width = info.width;
    image.height = info.height;
    image.encoding = "rgb8";
    image.step = 3 * image.width;
    image.data.assign(std::size_t{image.step} * image.height, 90);
    bag.write(tum_topic::kCameraInfo, time, info);
    bag.write(tum_topic::kColor, time, image);
    image.encoding = "16UC1";
    image.step = 2 * image.width;
    image.data.assign(std::size_t{image.step} * image.height, 4);
    bag.write(tum_topic::kDepth, time, image);
  }
}

/// Writes the files of the sequence and of a run on it.
void write_valid_files(const std::string& directory) {
  const SimulatedSequence sequence = make_sequence();
  Status written = write_sequence(sequence, coco(), directory);
  const std::unique_ptr<RunRecorder> recorder = make_run_recorder(shared_coco(), directory);
  const Options options;
  ObjectSlam slam(options, shared_coco());
  FrameBuilder builder(options.keyframe, sequence.camera);
  const auto process = [&](const Frame& frame, const std::vector<Detection>* detections) {
    record(frame, slam.process(frame, detections), recorder.get());
  };
  for (std::size_t i = 0; i < sequence.odometry.size(); ++i) {
    const auto& [stamp_ns, T_world_camera] = sequence.odometry[i];
    std::vector<Detection> detections;
    for (const SimulatedDetection& d : sequence.detections[i]) detections.push_back(d.detection);
    process(checked(builder.build({stamp_ns, T_world_camera})), &detections);
  }
  process(builder.end(), nullptr);
  if (written) written = recorder->write(directory);
  MapState map = *slam.map();
  map.submaps.resize(1);
  map.submaps[0].frames.resize(20);
  for (LocalObject& object : map.submaps[0].objects) object.views.clear();
  map.submaps[0].check_frames.clear();
  map.graph.loops.clear();
  map.objects.landmarks.resize(1);
  map.objects.landmarks[0].observations.resize(1);
  if (written) written = write_map(directory + "/map.db", map, *shared_coco());
  if (written) written = write_given_loops(directory + "/given_loops.csv", {LoopClosure(), LoopClosure()});
  write_valid_bag(directory + "/plain.bag", rosbag::compression::Uncompressed);
  write_valid_bag(directory + "/packed.bag", rosbag::compression::BZ2);
  const cv::Mat color(24, 32, CV_8UC3, cv::Scalar(50, 90, 130)), depth(24, 32, CV_16UC1, cv::Scalar(5000));
  if (!written || !cv::imwrite(directory + "/color.png", color) || !cv::imwrite(directory + "/depth.png", depth)) {
    std::fprintf(stderr, "fuzz_files: no valid files: %s\n", written.message().c_str());
    std::exit(1);
  }
}

/// The first lines of a file, which is enough and quick.
std::string head(const std::string& path, std::size_t size = 6000) {
  const std::string text = read_whole(path);
  return text.size() <= size ? text : text.substr(0, text.rfind('\n', size) + 1);
}

const char kGraph3[] =
    "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\nVERTEX_SE3:QUAT 1 1 0 0 0 0 0 1\nFIX 0\nEDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 "
    "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1\nEDGE_SE3:QUAT 1 0 -1 0 0 0 0 0 1 1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 "
    "0 1\n";
const char kGraph2[] =
    "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0.1\nVERTEX_SE2 2 2 0 0.2\nEDGE_SE2 0 1 1 0 0.1 1 0 0 1 0 1\n"
    "EDGE_SE2 1 2 1 0 0.1 1 0 0 1 0 1\nEDGE_SE2 2 0 -2 0 -0.2 1 0 0 1 0 1\n";

/// @param valid directory with valid files; the reader's own directory holds the same beside the changed one
std::vector<Kind> make_kinds(const std::string& valid) {
  const ClassTable classes = coco();
  const auto file = [&valid](const std::string& name) { return head(valid + "/" + name); };
  const auto directory_of = [](const std::string& path) { return std::filesystem::path(path).parent_path().string(); };
  const std::string detections = R"([{"file_name": "1.5.png", "detections": [{"category_id": 41, "detection_score": 0.5,
    "bbox": [10.5, 20, 90, 80]}, {"category_id": 73, "detection_score": 0.9, "bbox": [110, 20, 190, 180]}]},
    {"file_name": "1.7.png", "detections": []}, {"file_name": "2.0.png", "detections": [{"category_id": 39,
    "detection_score": 1, "bbox": [1, 2, 30, 40]}]}])";
  const std::string results = R"([{"image_id": 1.5, "category_id": 41, "bbox": [10.5, 20, 90, 80], "score": 0.5},
    {"image_id": "2.0.png", "category_id": 73, "bbox": [110, 20, 80, 160], "score": 0.9}])";
  std::vector<std::string> cameras, tables, configs;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(STL_CONFIG_DIR)) {
    if (entry.path().extension() != ".yaml") continue;
    const std::string path = entry.path().string(), text = head(path, kMaxSize);
    (path.find("/camera/") != std::string::npos  ? cameras
     : path.find("classes") != std::string::npos ? tables
                                                 : configs)
        .push_back(text);
  }
  const auto image = [](const std::string& color, const std::string& depth) {
    DepthOptions options;
    options.scale = 5000.0;
    const Silence silence;
    return status_of(read_rgbd_image({1, color, depth}, small_camera(), options));
  };
  return {
      {"detections, JSON",
       "d.json",
       {detections, results},
       [classes](const std::string& path) { return status_of(read_detections(path, classes)); }},
      {"detections, YOLO",
       "yolo/1.5.txt",
       {"41 10 20 80 60 0.5\n73 110 20 80 160 0.9\n", ""},
       [=](const std::string& path) { return status_of(read_detections(directory_of(path), classes)); }},
      {"trajectory",
       "t.txt",
       {file("trajectory.txt")},
       [](const std::string& path) { return status_of(read_tum_trajectory(path)); }},
      {"ground truth",
       "g.txt",
       {file("groundtruth.txt")},
       [](const std::string& path) { return status_of(read_tum_ground_truth(path)); }},
      {"associations",
       "a.txt",
       {"1.0 rgb/1.png 1.01 depth/1.png\n2.0 rgb/2.png 2.01 depth/2.png\n# end\n"},
       [](const std::string& path) { return status_of(read_associations(path, "images")); }},
      {"rgb.txt",
       "tum/rgb.txt",
       {"# color\n1.0 rgb/1.png\n1.05 rgb/2.png\n2.0 rgb/3.png\n"},
       [=](const std::string& path) { return status_of(associate_images(directory_of(path))); }},
      {"color image",
       "c.png",
       {read_whole(valid + "/color.png")},
       [=](const std::string& path) { return image(path, valid + "/depth.png"); }},
      {"depth image",
       "z.png",
       {read_whole(valid + "/depth.png")},
       [=](const std::string& path) { return image(valid + "/color.png", path); }},
      {"bag",
       "b.bag",
       {read_whole(valid + "/plain.bag"), read_whole(valid + "/packed.bag")},
       [](const std::string& path) {
         const Silence silence;
         const auto recording = open_tum_bag(path, small_camera(), {});
         if (!recording) return Status(recording.error());
         while (true) {
           const Result<std::optional<RgbdReading>> reading = recording->next();
           if (!reading) return Status(reading.error());
           if (!*reading) return Status();
         }
       }},
      {"camera", "camera.yaml", cameras, [](const std::string& path) { return status_of(read_camera(path)); }},
      {"class table", "classes.yaml", tables,
       [](const std::string& path) { return status_of(read_class_table(path)); }},
      {"config", "config.yaml", configs, [](const std::string& path) { return status_of(load_options(path, {})); }},
      {"map",
       "map.db",
       {read_whole(valid + "/map.db")},
       [classes](const std::string& path) { return status_of(read_map(path, classes)); }},
      {"reference objects",
       "r.csv",
       {file("reference_objects.csv")},
       [](const std::string& path) { return status_of(read_reference_objects(path)); }},
      {"objects",
       "o.csv",
       {file("objects.csv")},
       [](const std::string& path) { return status_of(read_objects(path)); }},
      {"keyframes",
       "k.csv",
       {file("keyframes.csv")},
       [](const std::string& path) { return status_of(read_keyframes(path)); }},
      {"loops", "l.csv", {file("loops.csv")}, [](const std::string& path) { return status_of(read_loops(path)); }},
      {"loop objects",
       "lo.csv",
       {file("loop_objects.csv")},
       [](const std::string& path) { return status_of(read_loop_objects(path)); }},
      {"given loops",
       "gl.csv",
       {file("given_loops.csv"), file("loops.csv")},
       [](const std::string& path) { return status_of(read_given_loops(path)); }},
      {"sightings",
       "run/associations.csv",
       {file("associations.csv")},
       [=](const std::string& path) { return status_of(read_sightings(directory_of(path))); }},
      {"pose graph",
       "g.g2o",
       {kGraph3, kGraph2},
       [](const std::string& path) {
         G2oRefusals refusals;
         Result<G2oGraph> graph = read_g2o(path, &refusals);
         if (!graph) return Status(graph.error());
         GraphOptimizerOptions options;
         options.max_iterations = 5;
         // What cannot be solved is an error of the graph, not of the file.
         static_cast<void>(status_of(optimize_graph(&*graph, options)));
         return Status();
       }},
  };
}

// --- the run ------------------------------------------------------------------------------------------------------

struct Counts {
  int files = 0, read = 0, refused = 0, harmful = 0;
};

void print(const std::string& kind, const Counts& counts) {
  std::printf("| %-17s | %7d | %7d | %7d | %7d |\n", kind.c_str(), counts.files, counts.read, counts.refused,
              counts.harmful);
  std::fflush(stdout);
}

/// @return what is wrong with how the reader took the file; empty if nothing
std::string judge(const Kind& kind, const std::string& path, Counts* counts) {
  try {
    const Status status = kind.read(path);
    ++(status ? counts->read : counts->refused);
    const std::string folder = std::filesystem::path(path).parent_path().string();
    if (status || status.message().find(folder) != std::string::npos) return {};
    return "the error does not name the file: " + status.message();
  } catch (const std::exception& exception) {
    return std::string("an exception: ") + exception.what();
  }
}

Counts fuzz(const Kind& kind, const std::string& directory, int files, std::uint64_t seed) {
  Mutator mutator(seed);
  Counts counts;
  counts.files = files;
  const std::string path = directory + "/" + kind.file;
  for (const std::string& seed_text : kind.seeds) {
    std::ofstream(path, std::ios::binary) << seed_text;
    const Status valid = kind.read(path);
    if (valid) continue;
    std::printf("fuzz_files: the valid file of %s is refused: %s\n", kind.name.c_str(), valid.message().c_str());
    ++counts.harmful;
  }
  for (int i = 0; i < files; ++i) {
    const std::string text = mutator.mutate(kind.seeds);
    std::ofstream(path, std::ios::binary) << text;
    current = "fuzz_files: hangs or died at " + kind.name + ", file " + std::to_string(i) + " of seed " +
              std::to_string(seed) + ": " + path + "\n";
    ::alarm(kHang_s);
    const std::string harm = judge(kind, path, &counts);
    ::alarm(0);
    if (harm.empty()) continue;
    if (++counts.harmful > 5) continue;
    std::string kept = "harmful_" + std::filesystem::path(kind.file).filename().string() + "_" + std::to_string(i);
    std::ofstream(kept, std::ios::binary) << text;
    std::printf("fuzz_files: %s, file %d of seed %llu, kept as %s: %s\n", kind.name.c_str(), i,
                static_cast<unsigned long long>(seed), kept.c_str(), harm.c_str());
  }
  print(kind.name, counts);
  return counts;
}

int run(int files, std::uint64_t seed, const std::string& only) {
  const TestDirectory valid, changed;
  write_valid_files(valid.path(""));
  for (const char* folder : {"yolo", "tum", "run"}) std::filesystem::create_directories(changed.path(folder));
  changed.write("tum/depth.txt", "1.01 depth/1.png\n1.06 depth/2.png\n2.0 depth/3.png\n");
  for (const char* name : {"objects.csv", "trajectory.txt", "keyframes.csv"}) {
    std::filesystem::copy_file(valid.path(name), changed.path(std::string("run/") + name));
  }
  std::printf("| kind              |   files |    read | refused | harmful |\n| --- | --- | --- | --- | --- |\n");
  Counts all;
  for (const Kind& kind : make_kinds(valid.path(""))) {
    if (!only.empty() && kind.name != only) continue;
    const Counts counts = fuzz(kind, changed.path(""), files, seed);
    all.files += counts.files;
    all.read += counts.read;
    all.refused += counts.refused;
    all.harmful += counts.harmful;
  }
  print("all", all);
  return all.harmful == 0 ? 0 : 1;
}

}  // namespace
}  // namespace semantic_topo_loop::core

int main(int argc, char** argv) {
  if (argc < 2) {
    std::fprintf(stderr, "usage: fuzz_files FILES_A_KIND [SEED [KIND]]\n");
    return 2;
  }
  ::signal(SIGALRM, semantic_topo_loop::core::on_alarm);
  return semantic_topo_loop::core::run(std::atoi(argv[1]), argc > 2 ? std::strtoull(argv[2], nullptr, 10) : 1,
                                       argc > 3 ? argv[3] : "");
}
