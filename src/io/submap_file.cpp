#include "semantic_topo_loop/io/submap_file.h"

#include <cmath>

#include "io/json_field.h"
#include "semantic_topo_loop/io/text_file.h"

namespace semantic_topo_loop::core {
namespace {

constexpr char kFormat[] = "semantic_topo_loop submaps 1";

// --- writing ------------------------------------------------------------------------------------------------------

/// A micrometre, and a thousandth of a pixel: far below what boxes tell.
double rounded(double value) { return std::round(1e6 * value) / 1e6; }

template <class Vector>
Json array_of(const Vector& v) {
  Json array = Json::array();
  for (Eigen::Index i = 0; i < v.size(); ++i) array.push_back(rounded(v(i)));
  return array;
}

Json to_json(const SE3& T) {
  Eigen::Matrix<double, 7, 1> v;
  v << T.t, T.q.x(), T.q.y(), T.q.z(), T.q.w();
  return array_of(v);
}

Json to_json(const LocalFrame& frame) {
  Json boxes = Json::array();
  for (const ObservedBox& box : frame.boxes) {
    Json row = array_of(box.box.edges());
    row.push_back(box.landmark_id);
    row.push_back(box.class_id);
    row.push_back(box.truncated);
    boxes.push_back(std::move(row));
  }
  return {{"frame_id", frame.frame_id},
          {"anchor_from_camera", to_json(SE3(Mat3(frame.R_camera_local.transpose()), frame.position))},
          {"focal_px", array_of(frame.focal_px)},
          {"image", array_of(frame.image.edges())},
          {"boxes", std::move(boxes)}};
}

Json to_json(const LocalObject& object) {
  Json views = Json::array();
  for (const SubmapView& view : object.views) {
    Json row = array_of(view.box.edges());
    row.push_back(view.frame);
    if (view.depth_m > 0.0) {
      row.push_back(rounded(view.depth_m));
      row.push_back(view.truncated);
    }
    views.push_back(std::move(row));
  }
  return {{"landmark_id", object.landmark_id},          {"class_id", object.class_id},
          {"center", array_of(object.spheroid.center)}, {"log_axes", array_of(object.spheroid.log_axes)},
          {"seen_share", rounded(object.seen_share)},   {"views", std::move(views)}};
}

/// Millimetres, and thousandths of the normal: the noise of depth is above.
Json to_json(const Surfel& surfel) {
  Json row = Json::array();
  for (const Eigen::Vector3f& v : {surfel.position, surfel.normal}) {
    for (Eigen::Index i = 0; i < v.size(); ++i) row.push_back(std::round(1e3 * static_cast<double>(v(i))) / 1e3);
  }
  return row;
}

Json to_json(const LocalMap& map) {
  Json frames = Json::array(), objects = Json::array();
  for (const LocalFrame& frame : map.frames) frames.push_back(to_json(frame));
  for (const LocalObject& object : map.objects) objects.push_back(to_json(object));
  Json json = {{"keyframe_id", map.keyframe_id},
               {"frame_id", map.frame_id},
               {"stamp_ns", map.stamp_ns},
               {"begin_frame", map.begin_frame},
               {"end_frame", map.end_frame},
               {"end_ns", map.end_ns},
               {"span_s", map.span_s},
               {"map_from_anchor", to_json(map.T_odom_anchor)},
               {"up", array_of(map.up.direction)},
               {"up_certain", map.up.certain},
               {"check_frames", map.check_frames},
               {"frames", std::move(frames)},
               {"objects", std::move(objects)}};
  if (map.surfels) {
    Json& surfels = json["surfels"] = Json::array();
    for (const Surfel& surfel : *map.surfels) surfels.push_back(to_json(surfel));
  }
  return json;
}

// --- reading ------------------------------------------------------------------------------------------------------

struct SubmapReader {
  const ClassTable& classes;

  LocalMap read(const JsonField& field) const {
    LocalMap map;
    map.keyframe_id = field.member("keyframe_id").integer();
    map.frame_id = field.member("frame_id").integer();
    map.stamp_ns = field.member("stamp_ns").integer();
    map.begin_frame = field.member("begin_frame").integer();
    map.end_frame = field.member("end_frame").integer();
    map.end_ns = field.member("end_ns").integer();
    map.span_s = field.member("span_s").number();
    map.T_odom_anchor = field.member("map_from_anchor").pose();
    map.up.direction = field.member("up").numbers<3>();
    if (!(map.up.direction.norm() > 0.5)) field.member("up").reject("is no direction");
    map.up.direction.normalize();
    map.up.certain = field.member("up_certain").flag();
    for (const JsonField& frame : field.member("frames").elements()) map.frames.push_back(read_frame(frame));
    for (const JsonField& index : field.member("check_frames").elements()) {
      map.check_frames.push_back(index.index(map.frames.size()));
    }
    for (const JsonField& object : field.member("objects").elements()) {
      map.objects.push_back(read_object(object, map.frames.size()));
    }
    if (field.has("surfels")) {
      std::vector<Surfel> surfels;
      for (const JsonField& row : field.member("surfels").elements()) surfels.push_back(read_surfel(row));
      map.surfels = std::make_shared<const std::vector<Surfel>>(std::move(surfels));
    }
    return map;
  }

  LocalFrame read_frame(const JsonField& field) const {
    LocalFrame frame;
    frame.frame_id = field.member("frame_id").integer();
    const SE3 T_local_camera = field.member("anchor_from_camera").pose();
    frame.R_camera_local = T_local_camera.rotation().transpose();
    frame.position = T_local_camera.t;
    frame.t_camera_local = -frame.R_camera_local * frame.position;
    frame.focal_px = field.member("focal_px").numbers<2>();
    if (!(frame.focal_px.minCoeff() > 0.0)) field.member("focal_px").reject("must be > 0");
    frame.image = field.member("image").box();
    for (const JsonField& row : field.member("boxes").elements()) frame.boxes.push_back(read_box(row));
    return frame;
  }

  /// x1, y1, x2, y2, landmark, class, truncated sides.
  ObservedBox read_box(const JsonField& row) const {
    const std::vector<JsonField> fields = row.elements();
    ObservedBox box;
    if (fields.size() != 7) {
      row.reject("must have 7 fields");
      return box;
    }
    box.box = row.box();
    box.landmark_id = fields[4].integer();
    box.class_id = read_class(fields[5]);
    box.label = classes.label(box.class_id);
    box.truncated = read_truncation(fields[6]);
    return box;
  }

  static std::uint8_t read_truncation(const JsonField& field) {
    const std::int64_t truncated = field.integer();
    if (truncated < 0 || truncated > 15) field.reject("must be a sum of 1, 2, 4, 8");
    return static_cast<std::uint8_t>(truncated);
  }

  LocalObject read_object(const JsonField& field, std::size_t frames) const {
    LocalObject object;
    object.landmark_id = field.member("landmark_id").integer();
    object.class_id = read_class(field.member("class_id"));
    object.label = classes.label(object.class_id);
    object.spheroid.center = field.member("center").numbers<3>();
    object.spheroid.log_axes = field.member("log_axes").numbers<2>();
    constexpr double kMaxLogAxis = 10.0;  // 22 km
    if (!(object.spheroid.log_axes.cwiseAbs().maxCoeff() < kMaxLogAxis)) {
      field.member("log_axes").reject("must be logs of metres");
    }
    object.seen_share = field.member("seen_share").number();
    for (const JsonField& row : field.member("views").elements()) {
      const std::vector<JsonField> fields = row.elements();
      if (fields.size() != 5 && fields.size() != 7) {
        row.reject("must have 5 or 7 fields");
        break;
      }
      SubmapView view{fields[4].index(frames), row.box()};
      if (fields.size() == 7) {
        view.depth_m = fields[5].number();
        if (!(view.depth_m > 0.0)) fields[5].reject("must be > 0");
        view.truncated = read_truncation(fields[6]);
      }
      object.views.push_back(view);
    }
    return object;
  }

  /// x, y, z, normal.
  static Surfel read_surfel(const JsonField& row) {
    const Eigen::Matrix<float, 6, 1> v = row.numbers<6>().cast<float>();
    constexpr float kTolerance = 0.01F;  // on the length of a rounded normal
    if (!(std::abs(v.tail<3>().norm() - 1.0F) < kTolerance)) row.reject("has no unit normal");
    return {v.head<3>(), v.tail<3>().normalized()};
  }

  int read_class(const JsonField& field) const {
    const int id = field.small_integer();
    if (!classes.is_mappable(id)) field.reject("is no class that becomes a landmark in the class table");
    return id;
  }
};

}  // namespace

Status write_submaps(const std::string& path, const std::vector<LocalMap>& submaps) {
  Json rows = Json::array();
  for (const LocalMap& submap : submaps) rows.push_back(to_json(submap));
  const Json file = {{"format", kFormat}, {"submaps", std::move(rows)}};
  return write_text_file(path, file.dump() + '\n');
}

Result<std::vector<LocalMap>> read_submaps(const std::string& path, const ClassTable& classes) {
  const Result<std::string> text = read_text_file(path);
  if (!text) return text.error();
  const Result<Json> root = parse_json(*text);
  if (!root) return Error{path + ": " + root.message()};
  std::string problem;
  std::vector<LocalMap> submaps;
  const JsonField file(*root, "", &problem);
  const Json* format = root->is_object() && root->contains("format") ? &(*root)["format"] : nullptr;
  if (format == nullptr || *format != kFormat) file.reject(std::string("has no \"format\": \"") + kFormat + '"');
  const SubmapReader reader{classes};
  if (file.is_fine()) {
    for (const JsonField& submap : file.member("submaps").elements()) {
      submaps.push_back(reader.read(submap));
      if (!file.is_fine()) break;
    }
    if (submaps.empty()) file.reject("holds no submap");
  }
  if (!problem.empty()) return Error{path + ": " + problem};
  return submaps;
}

}  // namespace semantic_topo_loop::core
