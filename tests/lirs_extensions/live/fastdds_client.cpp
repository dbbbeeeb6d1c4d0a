// A client over Fast DDS, the default middleware of Humble and Jazzy: stores what it receives, answers scans.
//   fastdds_client DOMAIN SCANS CLOUDS SPEED FILE [best_effort]
// A record of the file is a letter (s scan, c cloud, d ros_discovery_info), the size, and the bytes.
// Standard output has a line `TOPIC TYPE USER-DATA` for each publisher that was discovered.
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iostream>
#include <mutex>
#include <string>
#include <vector>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/domain/DomainParticipantListener.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;
using Bytes = std::vector<unsigned char>;

// Messages as CDR bytes, which no generated code decodes.
class Raw : public TopicDataType {
 public:
  explicit Raw(const std::string& name) {
    setName(name.c_str());
    m_typeSize = 1 << 21;
    m_isGetKeyDefined = false;
  }
  bool serialize(void* data, SerializedPayload_t* payload) override {
    auto& bytes = *static_cast<Bytes*>(data);
    if (bytes.size() > payload->max_size) return false;
    std::memcpy(payload->data, bytes.data(), bytes.size());
    payload->length = bytes.size();
    payload->encapsulation = CDR_LE;
    return true;
  }
  bool deserialize(SerializedPayload_t* payload, void* data) override {
    static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
    return true;
  }
  std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
    return [data] { return static_cast<uint32_t>(static_cast<Bytes*>(data)->size()); };
  }
  void* createData() override { return new Bytes; }
  void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
  bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

struct Counts {
  std::mutex mutex;
  std::condition_variable changed;
  int scans = 0, clouds = 0;
};

// TwistStamped in CDR: stamp, frame "base_link", linear and angular velocity.
static Bytes twist(const unsigned char* stamp, double speed) {
  Bytes message = {0, 1, 0, 0};
  auto add = [&](const void* value, size_t size) {
    auto begin = static_cast<const unsigned char*>(value);
    message.insert(message.end(), begin, begin + size);
  };
  add(stamp, 8);
  uint32_t length = 10;
  add(&length, 4);
  add("base_link", 10);
  while ((message.size() - 4) % 8) message.push_back(0);
  double values[6] = {speed, 0, 0, 0, 0, 0};
  add(values, sizeof values);
  return message;
}

class Listener : public DataReaderListener {
 public:
  Listener(char kind, Counts& counts, std::ofstream& file, DataWriter* answers, double speed)
      : kind_(kind), counts_(counts), file_(file), answers_(answers), speed_(speed) {}
  void on_data_available(DataReader* reader) override {
    Bytes bytes;
    SampleInfo info;
    while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data) continue;
      std::lock_guard<std::mutex> lock(counts_.mutex);
      uint32_t size = bytes.size();
      file_.put(kind_).write(reinterpret_cast<char*>(&size), 4);
      file_.write(reinterpret_cast<char*>(bytes.data()), size);
      if (kind_ != 'd') (kind_ == 's' ? counts_.scans : counts_.clouds)++;
      if (answers_) {
        Bytes answer = twist(bytes.data() + 4, speed_);
        answers_->write(&answer);
      }
      counts_.changed.notify_all();
    }
  }

 private:
  char kind_;
  Counts& counts_;
  std::ofstream& file_;
  DataWriter* answers_;
  double speed_;
};

// Prints what `ros2 topic info -v` shows of publishers.
class Discovery : public DomainParticipantListener {
 public:
  void on_publisher_discovery(DomainParticipant*, eprosima::fastrtps::rtps::WriterDiscoveryInfo&& found) override {
    if (found.status != found.DISCOVERED_WRITER) return;
    const auto& data = found.info.m_qos.m_userData.getValue();
    std::cout << found.info.topicName() << " " << found.info.typeName() << " "
              << std::string(data.begin(), data.end()) << std::endl;
  }
};

int main(int argc, char** argv) {
  if (argc < 6) return 2;
  const int scans = std::atoi(argv[2]), clouds = std::atoi(argv[3]);
  const bool best_effort = argc > 6;
  std::ofstream file(argv[5], std::ios::binary);
  Discovery discovery;
  // Without shared memory, of which a killed process would leave files behind.
  DomainParticipantQos quality;
  quality.transport().use_builtin_transports = false;
  quality.transport().user_transports.push_back(std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>());
  auto participant = DomainParticipantFactory::get_instance()->create_participant(
      std::atoi(argv[1]), quality, &discovery, StatusMask::none());
  TypeSupport twist_type(new Raw("geometry_msgs::msg::dds_::TwistStamped_"));
  TypeSupport scan_type(new Raw("sensor_msgs::msg::dds_::LaserScan_"));
  TypeSupport cloud_type(new Raw("sensor_msgs::msg::dds_::PointCloud2_"));
  TypeSupport graph_type(new Raw("rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"));
  for (auto type : {&twist_type, &scan_type, &cloud_type, &graph_type}) type->register_type(participant);
  auto topic = [&](const char* name, TypeSupport& type) {
    return participant->create_topic(name, type.get_type_name(), TOPIC_QOS_DEFAULT);
  };
  DataWriterQos written;
  written.reliability().kind = RELIABLE_RELIABILITY_QOS;
  written.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
  auto answers = participant->create_publisher(PUBLISHER_QOS_DEFAULT)
                     ->create_datawriter(topic("rt/cmd_vel", twist_type), written);
  PublicationMatchedStatus matched;
  for (int k = 0; k < 6000; ++k) {
    answers->get_publication_matched_status(matched);
    if (matched.current_count > 0) break;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  DataReaderQos read;
  read.reliability().kind = best_effort ? BEST_EFFORT_RELIABILITY_QOS : RELIABLE_RELIABILITY_QOS;
  read.history().depth = 10;
  read.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
  Counts counts;
  const double speed = std::atof(argv[4]);
  Listener on_scan('s', counts, file, clouds ? nullptr : answers, speed);
  Listener on_cloud('c', counts, file, clouds ? answers : nullptr, speed);
  auto subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
  DataReaderQos latched = read;
  latched.reliability().kind = RELIABLE_RELIABILITY_QOS;
  latched.durability().kind = TRANSIENT_LOCAL_DURABILITY_QOS;
  Listener on_graph('d', counts, file, nullptr, 0);
  subscriber->create_datareader(topic("ros_discovery_info", graph_type), latched, &on_graph);
  if (clouds) subscriber->create_datareader(topic("rt/points", cloud_type), read, &on_cloud);
  subscriber->create_datareader(topic("rt/scan", scan_type), read, &on_scan);
  std::unique_lock<std::mutex> lock(counts.mutex);
  auto last = std::chrono::steady_clock::now();
  int before = -1;
  while (counts.scans < scans || counts.clouds < clouds) {
    counts.changed.wait_for(lock, std::chrono::seconds(1));
    auto now = std::chrono::steady_clock::now();
    if (counts.scans + counts.clouds != before) last = now;
    before = counts.scans + counts.clouds;
    if (now - last > std::chrono::seconds(before ? 10 : 60)) break;
  }
  file.flush();
  std::cout << counts.scans << " scans, " << counts.clouds << " clouds" << std::endl;
  std::_Exit(0);
}
