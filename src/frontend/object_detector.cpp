#include "semantic_topo_loop/frontend/object_detector.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <opencv2/core/utils/logger.hpp>
#include <opencv2/dnn.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>
#include <string>
#include <system_error>
#include <utility>

#include "frontend/onnx_input.h"
#include "frontend/yolo_output.h"

namespace semantic_topo_loop::core {
namespace {

/// OpenCV logs what it throws, too.
class Silence {
 public:
  Silence() : level_(cv::utils::logging::setLogLevel(cv::utils::logging::LOG_LEVEL_SILENT)) {}
  ~Silence() { cv::utils::logging::setLogLevel(level_); }
  Silence(const Silence&) = delete;
  Silence& operator=(const Silence&) = delete;

 private:
  cv::utils::logging::LogLevel level_;
};

/// The first line of what OpenCV says.
std::string cause(const cv::Exception& exception) {
  const std::string& text = exception.err.empty() ? exception.msg : exception.err;
  return text.substr(0, text.find('\n'));
}

constexpr char kPrepare[] = " (an export that this OpenCV does not run: rosrun semantic_topo_loop prepare_model)";

/// An image on the model's square, as the model was trained:  model pixel = scale R (image pixel) + offset
struct Letterbox {
  Vec2 scale = Vec2::Ones();                        ///< model pixels in one of the image, along x and y
  Eigen::Matrix2d R = Eigen::Matrix2d::Identity();  ///< that turns the image upright
  Vec2 offset = Vec2::Zero();                       ///< model pixels
  cv::Mat blob;                                     ///< 1 x 3 x S x S

  /// The box, in the image, of the ellipse that touches a box on the square from inside.
  Box to_image(const Box& box) const {
    const Vec4 edges = (box.edges() - offset.replicate<2, 1>()).cwiseQuotient(scale.replicate<2, 1>());
    const Vec2 center = R.transpose() * (0.5 * (edges.head<2>() + edges.tail<2>()));
    const Vec2 half = 0.5 * (edges.tail<2>() - edges.head<2>());
    const Vec2 in_image = (R.transpose().cwiseAbs2() * half.cwiseAbs2()).cwiseSqrt();
    const Vec2 min = center - in_image, max = center + in_image;
    return {min.x(), min.y(), max.x(), max.y()};
  }
};

Letterbox letterbox(const cv::Mat& color, double roll_rad, int input_px, YoloLayout layout) {
  constexpr double kUpright_rad = 0.35;  // 20 deg, up to which detectors hardly mind
  cv::Mat bgr = color;
  if (color.channels() == 1) cv::cvtColor(color, bgr, cv::COLOR_GRAY2BGR);
  Letterbox box;
  if (std::abs(roll_rad) > kUpright_rad) box.R = Eigen::Rotation2Dd(roll_rad).toRotationMatrix();
  const Vec2 size = box.R.cwiseAbs() * Vec2(bgr.cols, bgr.rows);  // of the image, turned
  const double scale = static_cast<double>(input_px) / size.maxCoeff();
  const int width = std::clamp(static_cast<int>(std::lround(size.x() * scale)), 1, input_px);
  const int height = std::clamp(static_cast<int>(std::lround(size.y() * scale)), 1, input_px);
  // YOLOX is trained with the image in the corner, on values of 0 to 255 in OpenCV's order; the others with it in the
  // middle, on 0 to 1 in red, green, blue.
  const bool is_yolox = layout == YoloLayout::kYolox;
  const int left = is_yolox ? 0 : (input_px - width) / 2, top = is_yolox ? 0 : (input_px - height) / 2;
  constexpr double kGray = 114.0;  // of the border, in all of these trainings
  cv::Mat square(input_px, input_px, CV_8UC3, cv::Scalar::all(kGray));
  if (box.R.isIdentity(0.0)) {
    box.offset = {left, top};
    box.scale = Vec2(width, height).cwiseQuotient(size);
    cv::resize(bgr, square(cv::Rect(left, top, width, height)), {width, height});
  } else {
    box.scale.setConstant(scale);
    const Eigen::Matrix2d A = scale * box.R;
    box.offset = Vec2(left + 0.5 * width, top + 0.5 * height) - A * Vec2(0.5 * bgr.cols, 0.5 * bgr.rows);
    // Boxes, and cv::resize, count from the corner of the first pixel; cv::warpAffine from its middle.
    const Vec2 half = Vec2::Constant(0.5), shift = box.offset + A * half - half;
    const cv::Matx23d to_square(A(0, 0), A(0, 1), shift.x(), A(1, 0), A(1, 1), shift.y());
    cv::warpAffine(bgr, square, to_square, square.size(), cv::INTER_LINEAR, cv::BORDER_CONSTANT,
                   cv::Scalar::all(kGray));
  }
  cv::dnn::blobFromImage(square, box.blob, is_yolox ? 1.0 : 1.0 / 255.0, {}, {}, !is_yolox);
  return box;
}

}  // namespace

class ObjectDetector::Impl {
 public:
  explicit Impl(const ObjectDetectorOptions& options) : options_(options) {}

  Status load(const ClassTable& classes) {
    using namespace cv::dnn;
    const Backend backend = options_.backend == "cuda" ? DNN_BACKEND_CUDA : DNN_BACKEND_OPENCV;
    const Target target = options_.backend == "cuda"     ? DNN_TARGET_CUDA
                          : options_.backend == "opencl" ? DNN_TARGET_OPENCL
                                                         : DNN_TARGET_CPU;
    const std::vector<Target> targets = getAvailableTargets(backend);
    if (std::find(targets.begin(), targets.end(), target) == targets.end()) {
      return failure("cannot run with detector.backend=" + options_.backend + ", which this OpenCV or computer lacks");
    }
    // OpenCV takes a file that is not there for one that it does not understand.
    std::error_code code;
    if (std::filesystem::is_directory(options_.model, code)) return failure("is a directory, not a file");
    if (!std::ifstream(options_.model)) return failure("cannot open the file");
    const Silence silence;
    try {
      net_ = readNetFromONNX(options_.model);
    } catch (const cv::Exception& exception) {
      return failure("cannot be read as an ONNX model: " + cause(exception) + kPrepare);
    }
    net_.setPreferableBackend(backend);
    net_.setPreferableTarget(target);
    if (options_.threads > 0) cv::setNumThreads(options_.threads);
    if (const Status tried = try_sizes(); !tried) return tried;
    return name_classes(classes);
  }

  const std::string& warning() const { return warning_; }
  void set_options(const ObjectDetectorOptions& options) { options_ = options; }
  void restart() { last_slot_.reset(); }

  /// The first image of each slot of time, which slots are the same for every run over a recording.
  bool is_due(std::int64_t stamp_ns) {
    if (options_.rate_hz == 0.0) return true;
    const auto slot = static_cast<std::int64_t>(std::floor(1e-9 * static_cast<double>(stamp_ns) * options_.rate_hz));
    return std::exchange(last_slot_, slot) != slot;
  }

  Result<std::vector<Detection>> detect(const cv::Mat& color, double roll_rad) {
    if (color.empty() || (color.type() != CV_8UC3 && color.type() != CV_8UC1)) {
      return Error{"image of " + std::to_string(color.cols) + " x " + std::to_string(color.rows) + " pixels and type " +
                   cv::typeToString(color.type()) + ", not 8UC3 or 8UC1"};
    }
    const Letterbox box = letterbox(color, roll_rad, input_px_, layout_);
    std::vector<Detection> detections;
    try {
      const cv::Mat output = run(box.blob);
      for (Detection detection :
           suppress_overlapping(read_yolo(output, layout_, input_px_, options_.score), options_.nms_iou)) {
        detection.class_id = class_ids_[static_cast<std::size_t>(detection.class_id)];
        detection.box = clip(box.to_image(detection.box), color.cols, color.rows);
        if (detection.class_id >= 0 && detection.box.is_valid()) detections.push_back(detection);
      }
    } catch (const cv::Exception& exception) {
      return failure(cause(exception)).error();
    }
    return detections;
  }

 private:
  Status failure(const std::string& what) const { return Error{options_.model + ": " + what}; }

  cv::Mat run(const cv::Mat& blob) {
    net_.setInput(blob);
    return net_.forward();
  }

  /// Finds the size of the input and the layout of the output.
  Status try_sizes() {
    const DeclaredInput declared = declared_input(options_.model);
    if (options_.input_px == 0 && declared.width_px != declared.height_px) {
      return failure("it declares an input of " + std::to_string(declared.width_px) + " x " +
                     std::to_string(declared.height_px) +
                     " px, but images are given it as squares: export it for one " +
                     "(or state detector.input_px, if it takes any size)");
    }
    const int stated = options_.input_px > 0 ? options_.input_px : declared.width_px;
    const std::vector<int> sizes = stated > 0 ? std::vector{stated} : std::vector{416, 640};
    std::string problem;
    for (const int size : sizes) {
      const std::string with = "with an input of " + std::to_string(size) + " x " + std::to_string(size) + " px ";
      try {
        const cv::Mat output = run(cv::Mat(std::vector<int>{1, 3, size, size}, CV_32FC1, cv::Scalar(0.0)));
        const Result<YoloLayout> layout = find_yolo_layout(output, size, options_.layout);
        if (layout) {
          if (const Status checked = check_yolo_values(output, *layout); !checked) return failure(checked.message());
          layout_ = *layout;
          input_px_ = size;
          class_count_ = yolo_class_count(output, layout_);
          output_shape_ = shape_of(output);
          return {};
        }
        problem += (problem.empty() ? "" : "; ") + with + layout.message();
      } catch (const cv::Exception& exception) {
        problem += (problem.empty() ? "" : "; ") + with + "it fails: " + cause(exception) + kPrepare;
      }
    }
    return failure(problem + " (detector.input_px, detector.layout)");
  }

  Status name_classes(const ClassTable& classes) {
    std::string unknown;
    if (options_.names.empty()) {
      for (int id = 0; id < class_count_; ++id) class_ids_.push_back(classes.find(id) != nullptr ? id : -1);
      const auto known = static_cast<std::size_t>(std::count_if(class_ids_.begin(), class_ids_.end(), is_known));
      if (known < classes.classes().size()) {
        warning_ = options_.model + ": its " + std::to_string(class_count_) + " classes are taken for the ids 0 to " +
                   std::to_string(class_count_ - 1) + " of the class table, which has others besides: are they? " +
                   "detector.names states them";
      }
    } else {
      std::ifstream file(options_.names);
      if (!file) return Error{options_.names + ": cannot open the file"};
      constexpr char kByteOrderMark[] = "\xEF\xBB\xBF", kBlanks[] = " \t\r";
      for (std::string line; std::getline(file, line);) {
        if (class_ids_.empty() && line.compare(0, 3, kByteOrderMark) == 0) line.erase(0, 3);
        const std::size_t begin = line.find_first_not_of(kBlanks), end = line.find_last_not_of(kBlanks);
        if (begin == std::string::npos) continue;
        const ObjectClass* found = classes.find(line.substr(begin, end - begin + 1));
        class_ids_.push_back(found != nullptr ? found->id : -1);
        if (found == nullptr) unknown += (unknown.empty() ? "" : ", ") + line.substr(begin, end - begin + 1);
      }
      if (class_ids_.size() != static_cast<std::size_t>(class_count_)) {
        return Error{options_.names + ": " + std::to_string(class_ids_.size()) + " names, but the output of " +
                     options_.model + " is " + output_shape_ + ", of " + std::to_string(class_count_) + " classes"};
      }
    }
    if (std::none_of(class_ids_.begin(), class_ids_.end(), is_known)) {
      return failure("the class table has none of its " + std::to_string(class_count_) + " classes");
    }
    if (!unknown.empty()) warning_ = options_.names + ": left out, since the class table has no such names: " + unknown;
    return {};
  }

  static bool is_known(int class_id) { return class_id >= 0; }

  ObjectDetectorOptions options_;
  std::string warning_;
  cv::dnn::Net net_;
  YoloLayout layout_ = YoloLayout::kYolox;
  int input_px_ = 0, class_count_ = 0;
  std::string output_shape_;
  std::optional<std::int64_t> last_slot_;
  std::vector<int> class_ids_;  ///< of the table, by the model's; -1 where it has none
};

ObjectDetector::ObjectDetector(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
ObjectDetector::~ObjectDetector() = default;

Result<std::unique_ptr<ObjectDetector>> ObjectDetector::load(const ObjectDetectorOptions& options,
                                                             const ClassTable& classes) {
  if (options.model.empty()) return Error{"detector.model is empty: it must name an ONNX file"};
  auto impl = std::make_unique<Impl>(options);
  if (const Status loaded = impl->load(classes); !loaded) return loaded.error();
  return std::unique_ptr<ObjectDetector>(new ObjectDetector(std::move(impl)));
}

void ObjectDetector::set_options(const ObjectDetectorOptions& options) { impl_->set_options(options); }
const std::string& ObjectDetector::warning() const { return impl_->warning(); }
void ObjectDetector::restart() { impl_->restart(); }
bool ObjectDetector::is_due(std::int64_t stamp_ns) { return impl_->is_due(stamp_ns); }
Result<std::vector<Detection>> ObjectDetector::detect(const cv::Mat& color, double roll_rad) {
  return impl_->detect(color, roll_rad);
}

}  // namespace semantic_topo_loop::core
